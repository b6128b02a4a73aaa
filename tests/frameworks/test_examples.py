"""The example of each framework trains, and its agent plays beside detectors."""

import importlib
import re

import gymnasium as gym
import numpy as np
import pytest

EXAMPLES = {
    "ppo": ("torch", "--steps 1024 --episodes 2", ["PPO", "regression", "random"]),
    "supervised": ("torch", "--windows 128 --episodes 2", ["supervised", "untrained", "reader", "lagged", "random"]),
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
    lines = [
        re.match(r"\| (\w+)[^|]* \| \d+ \|.* \| (-?[\d.]+)", line) for line in capsys.readouterr().out.splitlines()
    ]
    scores = [(line[1], float(line[2])) for line in lines if line]
    assert [agent for agent, _ in scores] == EXAMPLES[name][2]
    assert np.isfinite([score for _, score in scores]).all()


def test_a_truncated_game_has_the_value_of_its_last_window(monkeypatch):
    torch = pytest.importorskip("torch")
    ppo = importlib.import_module("ppo")
    monkeypatch.setattr(ppo, "GAMES", 4)
    monkeypatch.setattr(ppo, "ROUNDS", 1)
    torch.manual_seed(0)
    arguments = {"clusters": 3, "uavs": 12, "observation_steps": 20, "max_rounds": 1, "observe": ("velocity", "alive")}
    envs, twins = (gym.make_vec("USNET/MultiCluster-v0", 4, autoreset_mode="SameStep", **arguments) for _ in range(2))
    network = ppo.PairNetwork()
    for part in network.parameters():
        torch.nn.init.normal_(part)  # a new network has the value 0
    rollout, _ = ppo.play(envs, network, envs.reset(seed=0)[0])
    twins.reset(seed=0)
    _, reward, _, truncated, info = twins.step(rollout["action"][0].numpy().astype(np.int8))
    assert truncated.all()
    last = [torch.from_numpy(np.stack([one[name] for one in info["final_obs"]])) for name in ("velocity", "alive")]
    expected = torch.from_numpy(reward).float() + network(*last)[1] - rollout["value"][0]
    torch.testing.assert_close(rollout["advantage"][0], expected)
