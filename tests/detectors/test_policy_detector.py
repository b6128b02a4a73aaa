"""Policies as detectors: Stable-Baselines3's, TorchRL's, a plain module, and a detector there and back."""

from dataclasses import replace
from types import SimpleNamespace

import gymnasium as gym
import numpy as np
import pytest
from synthetic_windows import flight, window_of

from detectors.checks import check_detector
from detectors.checks.windows import STEPS
from detectors.policy_detector import PolicyDetector, observation_of
from usnet_env import ArgumentError, Window

UAVS = 14
SMALL = {"clusters": 2, "uavs": UAVS, "observation_steps": STEPS, "max_rounds": 4}


def a_window(alive=None, seed=0, round=1):
    velocity, _ = flight(np.random.default_rng(seed), sizes=(7, 5), steps=STEPS)
    return window_of(velocity, alive=alive, round=round)


class Bits:
    """Names the UAVs below a number, and counts its rounds in the state."""

    def __init__(self, below=3, dtype=np.float32):
        self.below, self.dtype, self.starts = below, dtype, []

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        assert deterministic
        assert episode_start.shape == (1,)
        self.starts.append((bool(episode_start[0]), state))
        action = np.arange(len(observation["alive"])) < self.below
        return action.astype(self.dtype), (0 if state is None else state) + 1


class One:
    def __init__(self, answer):
        self.answer = answer

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        return self.answer, None


def test_the_step_of_recorded_tracks_is_kept_for_policies_that_know_it():
    simulated = a_window()
    recorded = replace(simulated, step=0.5)
    assert Window.from_observation(observation_of(recorded)).step == 0.5
    assert Window.from_observation(observation_of(simulated)).step is None

    class Seeing(Bits):
        def predict(self, observation, **more):
            self.seen = set(observation)
            return super().predict(observation, **more)

    policy = Seeing()
    PolicyDetector(policy).detect(recorded)
    assert "step" in policy.seen
    policy.observation_space = gym.make("USNET/MultiCluster-v0", **SMALL).observation_space
    PolicyDetector(policy).detect(recorded)
    assert policy.seen == set(policy.observation_space.spaces)


@pytest.mark.parametrize("dtype", [np.float32, np.int8, bool, np.int64])
def test_bits_are_candidates_but_for_the_dead(dtype):
    alive = np.arange(UAVS) != 1
    detector = PolicyDetector(Bits(dtype=dtype))
    detector.reset(0)
    answer = detector.detect(a_window(alive))
    assert np.flatnonzero(answer.candidates).tolist() == [0, 2]
    np.testing.assert_array_equal(answer.scores, np.arange(UAVS) < 3)


def test_the_state_lives_for_an_episode():
    policy = Bits()
    detector = PolicyDetector(policy)
    for _ in range(2):
        detector.reset(0)
        for _ in range(3):
            detector.detect(a_window())
    assert policy.starts == 2 * [(True, None), (False, 1), (False, 2)]


@pytest.mark.parametrize("answer", [4, np.int64(4), np.array(4), np.array([4])])
def test_a_number_is_one_candidate(answer):
    found = PolicyDetector(One(answer)).detect(a_window())
    assert np.flatnonzero(found.candidates).tolist() == [4]


@pytest.mark.parametrize(
    ("policy", "arguments", "sentence"),
    [
        (None, {}, "policy must have predict"),
        (Bits, {}, "policy must have predict"),
        (SimpleNamespace(predict=max, env=1), {}, "policy must hold no environment"),
        (Bits(), {"observe": 3}, "observe must"),
        (Bits(), {"threshold": "high"}, "threshold must"),
        (One(np.full(UAVS, 0.5)), {}, "must give an action of 0 and 1"),
        (One(np.zeros(UAVS + 1)), {}, r"must give one number for each of 14 UAVs, got shape \(15,\)"),
        (One(UAVS), {}, "must give one number for each of 14 UAVs"),
        (One("head"), {}, "must give one number for each of 14 UAVs"),
    ],
)
def test_each_mistake_has_its_sentence(policy, arguments, sentence):
    with pytest.raises(ArgumentError, match=sentence):
        PolicyDetector(policy, **arguments).detect(a_window())


def test_it_keeps_the_contract():
    check_detector(
        PolicyDetector(Bits(below=2)),
        expected_failed_checks={"check_order_of_uavs": "the policy always names the first two UAVs"},
    )


# Plain PyTorch

torch = pytest.importorskip("torch")


class Follower(torch.nn.Module):
    """Scores a UAV by how much the others' next velocity agrees with its own; with a dropout that must be off."""

    def __init__(self, scale=1.0):
        super().__init__()
        self.drop = torch.nn.Dropout(0.9)
        self.scale = torch.nn.Parameter(torch.tensor(float(scale)))

    def forward(self, observation):
        velocity = self.drop(observation["velocity"])
        agreement = torch.einsum("btic,btjc->bij", velocity[:, 1:], velocity[:, :-1]).clamp(min=0)
        return self.scale * (agreement.sum(dim=1) - agreement.sum(dim=1).mean())


def test_a_plain_module_is_asked_without_gradients_in_the_mode_of_use():
    policy = Follower()
    policy.drop.eval()
    policy.train()
    policy.drop.eval()
    detector = PolicyDetector(policy, threshold=5.0)
    first, second = detector.detect(a_window()), detector.detect(a_window())
    np.testing.assert_array_equal(first.scores, second.scores)
    np.testing.assert_array_equal(first.candidates, first.scores > 5.0)
    assert policy.training
    assert not policy.drop.training, "each layer is left in the mode that it was in"
    check_detector(detector)
