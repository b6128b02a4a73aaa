"""The example of each framework trains, and its agent plays beside detectors."""

import importlib
import re
import sys

import numpy as np
import pytest

EXAMPLES = {
    "sb3_ppo": ("stable_baselines3", "--steps 512 --episodes 2", ["PPO", "lagged-regression", "random"]),
    "sb3_maskable_ppo": ("sb3_contrib", "--steps 512 --episodes 2", ["MaskablePPO", "lagged-regression", "random"]),
    "torchrl_ppo": ("torchrl", "--steps 512 --episodes 2", ["PPO", "lagged-regression"] * 2),
    "torchrl_observers": ("torchrl", "--updates 1 --games 2", ["REINFORCE", "lagged-regression", "random"]),
    "tianshou_ppo": ("tianshou", "--epochs 1 --episodes 2", ["PPO", "lagged-regression", "random"]),
    "minari_imitation": ("minari", "--games 3 --updates 2 --episodes 2", ["student", "teacher"] * 2),
    "supersuit_ppo": ("supersuit", "--steps 768 --games 2", ["PPO", "lagged-regression", "random"]),
}
pytestmark = [
    pytest.mark.filterwarnings("ignore:PettingZoo in TorchRL is tested using version:UserWarning"),
    pytest.mark.filterwarnings("ignore:Creating .* which inherits from WeightUpdaterBase:DeprecationWarning"),
]


def load(name, monkeypatch):
    """Import an example; Tianshou's loops stay Python: it compiles them anew in every process, which takes 15 s."""
    pytest.importorskip(EXAMPLES[name][0])
    example = importlib.import_module(name)
    for place in ("tianshou.algorithm.algorithm_base", "tianshou.data.buffer.manager"):
        for attribute, loop in list(vars(sys.modules.get(place, object())).items() if place in sys.modules else ()):
            if hasattr(loop, "py_func"):
                monkeypatch.setattr(f"{place}.{attribute}", loop.py_func)
    return example


@pytest.mark.parametrize("name", EXAMPLES)
def test_an_example_trains_and_compares_its_agent_with_detectors(name, capsys, monkeypatch):
    example = load(name, monkeypatch)
    monkeypatch.setenv("MINARI_DATASETS_PATH", "")  # put back afterwards
    example.main(EXAMPLES[name][1].split())
    lines = [re.match(r"(\S+) .*\bJ(?:_m)?: (-?[\d.]+)", line) for line in capsys.readouterr().out.splitlines()]
    scores = [(line[1], float(line[2])) for line in lines if line]
    assert [agent for agent, _ in scores] == EXAMPLES[name][2]
    assert np.isfinite([score for _, score in scores]).all()


@pytest.mark.slow
def test_ppo_of_stable_baselines_learns(monkeypatch):
    example = load("sb3_ppo", monkeypatch)
    from comparison import compare_detectors
    from how_copied import how_copied

    from detectors.policy_detector import PolicyDetector

    models = {"untrained": example.train(0), "trained": example.train(2048)}
    detectors = {name: PolicyDetector(model.policy, observe=how_copied) for name, model in models.items()}
    scores = compare_detectors(example.ENV, example.ARGUMENTS, detectors, episodes=30)
    assert scores["untrained"]["J"]["mean"] < -3.0
    assert scores["trained"]["J"]["mean"] >= -1.1


def test_a_network_learns_to_imitate_a_recorded_detector(tmp_path, monkeypatch):
    example = load("minari_imitation", monkeypatch)
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    dataset = example.record(30, seed=100)
    _, losses = example.imitate(dataset, updates=60)
    assert losses[-1] < 0.2 * losses[0]
    assert dataset.recover_environment().unwrapped.config.clusters == example.ARGUMENTS["clusters"]
