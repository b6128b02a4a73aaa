"""TorchRL reads the games of several agents, and observers who share a network learn."""

import numpy as np
import pytest

pytest.importorskip("torchrl")
pytest.importorskip("pettingzoo")

import torch
import torchrl_observers as example
from copied_network import CopiedNetwork
from observers_game import compare_detectors
from pettingzoo.utils import parallel_to_aec
from torchrl.envs import PettingZooWrapper, check_env_specs

from detectors.policy_detector import PolicyDetector
from usnet_env import make_detector
from usnet_env.multiagent import usnet_evasion_v0, usnet_observers_v0
from usnet_env.multiagent.wrappers import DiscreteActions, ParallelBoxMasks

pytestmark = pytest.mark.filterwarnings("ignore:PettingZoo in TorchRL is tested using version:UserWarning")

SMALL = {"clusters": 2, "uavs": 10, "observation_steps": 12, "max_rounds": 4}
GAMES = {
    "bits": (usnet_observers_v0.parallel_env, {}),
    "scores": (usnet_observers_v0.parallel_env, {"fusion": "scores"}),
    "messages": (usnet_observers_v0.parallel_env, {"message_size": 2}),
    "evasion": (usnet_evasion_v0.parallel_env, {}),
}


@pytest.mark.parametrize("name", GAMES)
def test_the_specs_hold(name):
    make, arguments = GAMES[name]
    game = ParallelBoxMasks(make(**SMALL, **arguments))
    check_env_specs(PettingZooWrapper(game, use_mask=name == "evasion"), seed=0)


@pytest.mark.parametrize("make", [usnet_observers_v0.parallel_env, usnet_evasion_v0.parallel_env])
def test_the_specs_hold_with_one_number_for_an_action(make):
    env = PettingZooWrapper(ParallelBoxMasks(DiscreteActions(make(**SMALL))), use_mask=True)
    check_env_specs(env, seed=0)
    assert ("observer", "action_mask") in env.reset(seed=0).keys(include_nested=True)


def test_the_specs_hold_in_turns():
    game = parallel_to_aec(ParallelBoxMasks(usnet_observers_v0.parallel_env(**SMALL)))
    check_env_specs(PettingZooWrapper(game, use_mask=True), seed=0)


def test_heads_that_were_destroyed_are_masked():
    env = PettingZooWrapper(ParallelBoxMasks(usnet_evasion_v0.parallel_env(**SMALL)), use_mask=True)
    env.set_seed(0)

    def everybody(tensordict):
        tensordict = env.rand_action(tensordict)
        tensordict["observer", "action"] = torch.ones_like(tensordict["observer", "action"])
        return tensordict

    played = env.rollout(3, everybody)
    assert played["head", "mask"][0].all()
    assert not played["next", "head", "mask"][-1].any()


def test_it_trains():
    network, returns = example.train(updates=2, games=4)
    assert np.isfinite(returns).all()
    torch.manual_seed(0)
    pairs = zip(network.parameters(), CopiedNetwork().parameters(), strict=True)
    assert all(bool((after != before).any()) for after, before in pairs)


@pytest.mark.slow
def test_it_learns_and_plays_games_as_a_detector():
    network, returns = example.train(updates=20, games=8)
    assert np.mean(returns[-4:]) > np.mean(returns[:4]) + 0.2
    detector = PolicyDetector(example.make_actor(network, ["velocity", "alive"]))
    scores = compare_detectors({"REINFORCE": detector, "random": make_detector("random(count=1)")}, games=5)
    assert scores["REINFORCE"] < scores["random"]


def test_the_script_prints_a_comparison(capsys):
    example.main(["--updates", "1", "--games", "2"])
    printed = [line.split()[0] for line in capsys.readouterr().out.splitlines()[1:]]
    assert printed == ["REINFORCE", "lagged-regression", "random"]
