"""The example of each framework trains, and its agent plays beside detectors."""

import importlib
import re

import numpy as np
import pytest

EXAMPLES = {
    "ppo": ("torch", "--steps 1024 --episodes 2", ["PPO", "regression", "random"]),
    "torchrl_ppo": ("torchrl", "--steps 1024 --episodes 2", ["PPO", "regression"] * 2),
    "minari_imitation": ("minari", "--games 3 --updates 2 --episodes 2", ["student", "teacher"] * 2),
}
pytestmark = [
    pytest.mark.filterwarnings("ignore:PettingZoo in TorchRL is tested using version:UserWarning"),
    pytest.mark.filterwarnings("ignore:Creating .* which inherits from WeightUpdaterBase:DeprecationWarning"),
]


@pytest.mark.slow
@pytest.mark.parametrize("name", EXAMPLES)
def test_an_example_trains_and_compares_its_agent_with_detectors(name, capsys, monkeypatch):
    pytest.importorskip(EXAMPLES[name][0])
    example = importlib.import_module(name)
    monkeypatch.setenv("MINARI_DATASETS_PATH", "")  # put back afterwards
    example.main(EXAMPLES[name][1].split())
    lines = [re.match(r"\| (\w+) \| \d+ \|.* \| (-?[\d.]+)", line) for line in capsys.readouterr().out.splitlines()]
    scores = [(line[1], float(line[2])) for line in lines if line]
    assert [agent for agent, _ in scores] == EXAMPLES[name][2]
    assert np.isfinite([score for _, score in scores]).all()
