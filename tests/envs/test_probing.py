"""The environment of probing: whom an intruder turns, what is seen when, what it costs, and the scripted probers."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from usnet_env import ArgumentError, Detection
from usnet_env.envs.play import play_probe
from usnet_env.envs.probers import TARGETS, Prober
from usnet_env.replay import EpisodeRecord, draw_episode
from usnet_env.replay.record import record_probe
from usnet_env.swarm import SwarmConfig, start
from usnet_env.swarm.kinematics import Avoidance, find_push
from usnet_env.swarm.simulator import fly_steps

PROBING = "USNET/Probing-v1"
SMALL = {"followers": 6, "observation_steps": 12}


@pytest.mark.parametrize("kinematics", ["unit", "lagged"])
@pytest.mark.parametrize("follow", ["f1", "f6", "unequal_delays"])
def test_only_the_followers_of_a_uav_turn_with_it(follow, kinematics):
    memory = {"unequal_delays": 12}.get(follow, 4)
    config = SwarmConfig(
        follow=follow, kinematics=kinematics, mobility="gauss_markov", clusters=1, uavs=8, decoys=1, memory=memory
    )

    def flown(near):
        rngs = [np.random.default_rng(4)]
        state = start(config, rngs)
        far = np.full((1, 1, 3), 1e5, np.float32)
        place = far if near is None else state.position[:, None, near] + np.float32(5.0)
        model = Avoidance(config.kinematics_model, place, np.zeros_like(place), 15.0, 3.0, 8)
        return fly_steps([config.model_copy(update={"kinematics": model})], state, rngs, 30)[1][0]

    rngs = [np.random.default_rng(4)]
    state = start(config, rngs)
    free = fly_steps([config], state, rngs, 30)[1][0]
    np.testing.assert_array_equal(flown(None), free)
    for near in range(8):
        moved = (flown(near) != free).any(axis=(0, 2))
        behind = state.root[0] == near
        np.testing.assert_array_equal(moved, behind | (np.arange(8) == near))


def test_the_push_leads_away_and_ends_at_the_reach():
    place = np.random.default_rng(0).uniform(-30, 30, (200, 3)).astype(np.float32)
    push = find_push(place, np.zeros((1, 3), np.float32), 20.0)
    far = np.linalg.norm(place, axis=1)
    np.testing.assert_array_equal(push.any(axis=1), far < 20.0)
    np.testing.assert_allclose((push * place).sum(axis=1), far * np.maximum(1 - far / 20.0, 0), atol=1e-4)


def test_alike_heads_and_decoys_differ_in_nothing_but_their_places():
    env = gym.make("USNET/SingleCluster-v0", mobility="alike", decoys=3)
    window, _ = env.reset(seed=0)
    free = env.unwrapped.swarm.head | env.unwrapped.swarm.decoy
    assert (np.ptp(window["velocity"][:, free], axis=1) == 0).all()
    assert np.ptp(window["velocity"][:, ~free], axis=1).all()


@pytest.mark.parametrize("actions", ["dict", "flat"])
def test_gymnasium_s_checker_has_nothing_to_say(actions):
    env = gym.make(PROBING, **SMALL, intruders=2, render_mode="rgb_array", actions=actions)
    check_env(env.unwrapped)
    assert list(env.reset(seed=0)[0]) == list(env.observation_space)


def wait(env, speed=0.0):
    """The action that names no UAV yet, with intruders that fly along the first axis."""
    steer = np.zeros((env.unwrapped.arguments.intruders, 3), np.float32)
    steer[:, 0] = speed
    return {"steer": steer, "name": env.unwrapped.config.uavs}


@pytest.mark.parametrize("sample_every", [1, 2])
def test_a_window_grows_and_its_past_stays(sample_every):
    faults = {"position_noise": 1.0, "noise_memory": 0.5, "miss_rate": 0.2, "miss_burst": 2.0}
    env = gym.make(PROBING, **SMALL, **faults, sample_every=sample_every, look_every=5)
    windows = [env.reset(seed=1)[0]]
    while windows[-1]["elapsed"] < 12:
        windows.append(env.step(wait(env, 1.0))[0])
    assert [int(window["elapsed"][0]) for window in windows] == [0, 5, 10, 12]
    for window in windows:
        elapsed = int(window["elapsed"][0])
        for name, instants in {"position": elapsed + 1, "seen": elapsed + 1, "velocity": elapsed}.items():
            np.testing.assert_array_equal(window[name][:instants], windows[-1][name][:instants])
            assert not window[name][instants:].any()
        np.testing.assert_array_equal(window["intruders"][: elapsed + 1], windows[-1]["intruders"][: elapsed + 1])
    moved = np.diff(windows[-1]["intruders"][:, 0], axis=0)
    np.testing.assert_allclose(moved, np.tile([4.0 * sample_every, 0, 0], (12, 1)), atol=1e-3)


def test_the_reward_is_the_objective_minus_time_and_moves():
    """The last look is shorter, and every intruder's way has its price."""
    env = gym.make(PROBING, **SMALL, look_every=8, time_price=0.3, move_price=0.6, intruders=2)
    for named, objective in ((None, -1.0), ("head", 0.0), ("follower", -1.0)):
        env.reset(seed=2)
        rewards = [env.step(wait(env, speed))[1] for speed in ([1.0, 0.5], [0.0, 0.5])]
        assert rewards == pytest.approx([-0.2 - 0.6, -0.1 - 0.1])
        action, head = wait(env, 1.0), env.unwrapped.swarm.head
        if named:
            action["name"] = np.flatnonzero(head == (named == "head"))[0]
        _, reward, terminated, truncated, info = env.step(action)
        assert (reward, terminated, truncated, info["J"]) == (objective, True, False, objective)
        assert sum(value for name, value in info.items() if name.startswith("reward_")) == reward
        with pytest.raises(ArgumentError, match="reset must be called"):
            env.step(action)


def test_intruders_start_where_no_uav_avoids_them():
    env = gym.make(PROBING, **SMALL, intruders=20)
    for seed in range(3):
        window, _ = env.reset(seed=seed)
        apart = np.linalg.norm(window["intruders"][0][:, None] - window["position"][0], axis=2)
        assert apart.min() >= 20.0


def test_a_flat_action_names_whose_score_stands_out_or_the_best_at_the_end():
    env = gym.make(PROBING, **SMALL, look_every=6, actions="flat")
    head = {}
    for seed, scores in enumerate(([1.0, -0.1], [1.0, 0.0], [0.5, -0.4])):
        env.reset(seed=seed)
        head[seed] = int(env.unwrapped.swarm.head.argmax())
        action = np.full(3 + 7 + 1, scores[1], np.float32)
        action[:3] = [0.6, 0, 0.8]
        action[3 + head[seed]] = scores[0]
        steps = []
        while not steps or not steps[-1][2]:
            steps.append(env.step(action))
        assert len(steps) == (1 if scores[0] - scores[1] > 1 else 3)
        assert steps[-1][1] == 0.0
        assert [step[1] for step in steps[:-1]] == pytest.approx([-0.15] * (len(steps) - 1))
    action[-1] = 1.0  # none is named, though the window is full
    env.reset(seed=2)
    assert [env.step(action)[1] for _ in range(3)] == pytest.approx([-0.15, -0.15, -1.0])


def test_an_agent_that_knows_nothing_mostly_waits():
    env = gym.make_vec(PROBING, 64, observation_steps=12, actions="flat", autoreset_mode="Disabled")
    env.reset(seed=0)
    rng, waiting = np.random.default_rng(0), 1.0
    for _ in range(3):
        actions = rng.standard_normal(env.action_space.shape).clip(-1, 1)  # of a new policy of Stable-Baselines3
        over = env.step(actions)[2]
        waiting *= 1 - over.mean()
        env.reset(options={"reset_mask": over}) if over.any() else None
    assert waiting > 0.9


@pytest.mark.parametrize(
    ("action", "words"),
    [
        ([0] * 7, "action must have the keys"),
        ({"steer": np.full((1, 3), 2.0), "name": 7}, "steer must have shape"),
        ({"steer": [[0], [0, 0]], "name": 7}, "steer must be an array"),
        ({"steer": np.zeros((1, 3)), "name": 8}, "name must hold whole numbers from 0 to 7"),
        (np.zeros(10), "action must have shape"),
    ],
)
def test_a_wrong_action_is_refused(action, words):
    flat = "flat" if isinstance(action, np.ndarray) else "dict"
    env = gym.make(PROBING, **SMALL, actions=flat, disable_env_checker=True)
    env.reset(seed=0)
    with pytest.raises(ArgumentError, match=words):
        env.step(action)


class Undecided:
    """A detector that takes all UAVs for equally probable heads."""

    def reset(self, seed=None):
        pass

    def detect(self, window):
        none = np.zeros(window.uavs)
        return Detection(none.astype(bool), none, extras={"probability": none + 1 / window.uavs})


@pytest.mark.parametrize("detector", [None, Undecided()])
@pytest.mark.parametrize("target", list(TARGETS))
def test_reactions_tell_the_head_from_alike_decoys(target, detector):
    env = gym.make(PROBING, followers=6, decoys=3, mobility="alike", observation_steps=80, intruders=2)
    played = [play_probe(env, Prober(detector, target), seed) for seed in range(8)]
    right = sum(episode.info["J"] == 0 for episode, _ in played)
    assert right >= 6 if target == "nearest" else right <= 8
    for episode, total in played:
        waited = episode.observation["elapsed"][0] / 80
        assert total <= episode.info["J"] - 0.2 * waited + 1e-9


def test_a_probe_is_recorded_and_drawn_and_its_target_must_be_known(tmp_path):
    with pytest.raises(ArgumentError, match="target must be one of"):
        Prober(target="nearer")
    env = gym.make(PROBING, **SMALL, intruders=2)
    record = record_probe(env, Prober(), 0)
    again = EpisodeRecord.load(record.save(tmp_path / "probe.npz"))
    assert again.intruders.shape == (1, 13, 2, 3)
    np.testing.assert_array_equal(again.intruders, record.intruders)
    texts = [text.get_text() for axes in draw_episode(again).axes for text in axes.get_legend().get_texts()]
    assert "intruder, with its track" in texts
