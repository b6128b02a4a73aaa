"""Mobility of heads, each law by its statistics; kinematics, each model by what it allows."""

from dataclasses import replace

import numpy as np
import pytest
from flights import flown, fly, turns, unit

from usnet_env import ArgumentError, register_mobility
from usnet_env.swarm import (
    FOLLOW_STRATEGIES,
    KINEMATICS,
    MOBILITIES,
    Kinematics,
    SwarmConfig,
    advance,
    register_kinematics,
    start,
)

NAMES = ["iid", "gauss_markov", "smooth_turn", "waypoint", "local_waypoint", "straight"]


def tracks(name, uavs=60, steps=1000, seed=0):
    """Velocities ``(steps, uavs, 3)`` and positions of UAVs that all fly by this law."""
    return flown(fly("none", mobility=name, memory=4, clusters=1, uavs=uavs, observation_steps=steps, seed=seed)[1])


@pytest.mark.parametrize("name", NAMES)
def test_every_law_flies_one_metre_a_step(name):
    velocity, position = tracks(name)
    np.testing.assert_allclose(np.linalg.norm(velocity, axis=-1), 1.0, atol=1e-5)
    np.testing.assert_allclose(np.diff(position, axis=0), velocity, atol=2e-4)


def test_iid_has_no_memory_and_no_preferred_axis():
    velocity, _ = tracks("iid")
    n = velocity[1:].size / 3
    assert abs((velocity[1:] * velocity[:-1]).sum(axis=-1).mean()) < 4 / np.sqrt(3 * n)
    np.testing.assert_allclose((velocity**2).mean(axis=(0, 1)), 1 / 3, atol=0.01)


def test_gauss_markov_angles_have_the_stated_memory_and_variances():
    velocity, _ = tracks("gauss_markov", uavs=200, steps=2000)
    pitch = np.arcsin(velocity[..., 2])
    assert pitch.var() == pytest.approx(0.02, rel=0.05)
    assert np.mean(pitch[1:] * pitch[:-1]) / pitch.var() == pytest.approx(0.85, abs=0.02)
    azimuth = np.unwrap(np.arctan2(velocity[..., 1], velocity[..., 0]), axis=0)
    azimuth -= azimuth.mean(axis=0)
    assert azimuth.var() == pytest.approx(0.2, rel=0.05)
    assert np.mean(azimuth[1:] * azimuth[:-1]) / azimuth.var() == pytest.approx(0.85, abs=0.02)


def test_smooth_turns_are_bounded_and_change():
    velocity, _ = tracks("smooth_turn")
    angle = turns(velocity)
    assert angle.max() <= 0.6 + 1e-3
    assert 0.1 < angle.mean() < 0.25  # truncated exponential with mean about 0.17
    held = np.mean(np.abs(np.diff(angle, axis=0)) < 1e-3)
    assert 0.8 < held < 0.95  # a turn is held for 10 steps on average


def test_waypoints_turn_gently_and_lie_in_the_arena_and_local_ones_turn_often_and_stay_near():
    velocity, position = tracks("waypoint", steps=5000)
    assert turns(velocity).max() <= 0.2 + 1e-3
    assert (position > -60).all()
    assert (position < np.array([1060, 1060, 160])).all()
    assert np.ptp(position[..., 0]) > 800
    velocity, position = tracks("local_waypoint")
    angle = turns(velocity)
    assert angle.max() <= 0.5 + 1e-3
    assert np.mean(angle > 0.3) > 0.1
    assert np.linalg.norm(position[-1] - position[0], axis=1).mean() < 300


@pytest.mark.parametrize("name", ["gauss_markov", "smooth_turn", "waypoint", "local_waypoint", "straight"])
def test_flight_goes_on_smoothly_between_rounds(name):
    config = SwarmConfig(mobility=name, clusters=2, uavs=9, observation_steps=20)
    rngs = [np.random.default_rng(0)]
    state = start(config, rngs)
    heads = state.episode().head
    state, one = advance(config, state, rngs)
    _, other = advance(config, state, rngs)
    gap = other.position[0, 0, heads] - one.position[0, -1, heads]
    assert (np.linalg.norm(gap, axis=1) > 2.0).all()  # T_0 = 4 unobserved steps in between, hardly turned
    assert ((one.velocity[0, -1, heads] * other.velocity[0, 0, heads]).sum(axis=1) > -0.2).all()


@pytest.mark.parametrize("noise", [0.05, 0.2])
@pytest.mark.parametrize("jitter", [False, True])
def test_followers_noise_has_its_size_and_jitter_gives_it_to_heads(jitter, noise):
    assert FOLLOW_STRATEGIES["f1"].noise == 0.05
    follow = replace(FOLLOW_STRATEGIES["f1"], noise=noise)
    state, window = fly(follow, mobility="straight", head_jitter=jitter, uavs=9, observation_steps=2000)
    velocity = flown(window)[0][:, state.head == jitter]
    mean = unit(velocity.mean(axis=0))
    across = velocity - (velocity * mean).sum(axis=-1, keepdims=True) * mean
    assert np.sqrt((across**2).sum(axis=-1).mean() / 2) == pytest.approx(noise, rel=0.05)


def test_a_registered_function_is_used_by_name_and_keeps_its_state():
    def circle(rng, position, steps, state):
        """Circles."""
        phase = state[:, 0] + 0.1 * np.arange(1, steps + 1)[:, None]
        state[:, 0] = phase[-1]
        return np.stack([np.cos(phase), np.sin(phase), np.zeros_like(phase)], axis=-1)

    register_mobility("test-circle", circle, replace=True)
    velocity, _ = tracks("test-circle")
    np.testing.assert_allclose(turns(velocity), 0.1, atol=1e-3)
    config = SwarmConfig(mobility="test-circle", clusters=2, uavs=9, observation_steps=10)
    rngs = [np.random.default_rng(0)]
    state = start(config, rngs)
    after, one = advance(config, state, rngs)
    _, two = advance(config, after, rngs)
    head = np.flatnonzero(state.head[0])[0]
    angle = turns(np.stack([one.velocity[0, -1, head], two.velocity[0, 0, head]])[:, None])[0, 0]
    assert angle == pytest.approx(0.5, abs=1e-3)  # T_0 = 4 unobserved steps, then one
    assert MOBILITIES["test-circle"].description == "Circles."
    with pytest.raises(ArgumentError, match="mobility must be a Mobility or a function"):
        register_mobility("test-x", 3)
    for bad, words in (
        (lambda *_: 3, "have shape .* got 3"),
        (lambda *_: np.zeros((1, 3)), r"have shape .* got \(1, 3\)"),
        (lambda rng, position, steps, state: np.full((steps, len(position), 3), np.nan), "hold finite numbers"),
    ):
        register_mobility("test-bad", bad, replace=True)
        with pytest.raises(ArgumentError, match=f"^directions of mobility 'test-bad' must {words}"):
            tracks("test-bad")


KINDS = ["unit", "varied_speed", "lagged", "limited", "layered"]


@pytest.mark.parametrize("follow", ["f2", "f6", "f7", "none"])
@pytest.mark.parametrize("name", KINDS)
def test_positions_integrate_velocities_and_bounds_hold(name, follow):
    state, window = fly(follow, kinematics=name, mobility="gauss_markov", bystanders=2, traffic=3)
    np.testing.assert_allclose(np.diff(window.position, axis=1), window.velocity, atol=3e-4)
    model = KINEMATICS[name]
    speed = np.linalg.norm(window.velocity[0], axis=-1)
    assert speed.max() <= model.top_speed * 1.001
    assert state.kinematic_state.shape == (24, model.values)
    if name == "limited":
        assert (turns(flown(window)[0]) <= state.kinematic_state[:, 0] + 1e-3).all()
        assert np.abs(np.diff(speed, axis=0)).max() <= model.acceleration + 1e-5
    if name == "layered":
        assert np.abs(window.velocity[..., 2]).max() <= model.climb + 1e-5


def test_speeds_vary_between_their_bounds():
    model = replace(KINEMATICS["varied_speed"], sigma=2.0)
    speed = np.linalg.norm(flown(fly("f2", kinematics=model)[1])[0], axis=-1)
    assert (speed.min(), speed.max()) == (pytest.approx(model.slowest), pytest.approx(model.fastest))


def test_a_lagged_uav_turns_by_its_share_of_the_gap():
    state, window = fly(replace(FOLLOW_STRATEGIES["f1"], noise=0.0), kinematics="lagged", mobility="gauss_markov")
    velocity, i = flown(window)[0], np.flatnonzero(~state.head)
    before, wanted = velocity[:-1, i], unit(velocity[:-1, state.root[i]])
    np.testing.assert_allclose(velocity[1:, i], before + state.kinematic_state[i] * (wanted - before), atol=1e-4)


def test_a_registered_model_is_used_by_name():
    class Half(Kinematics):
        top_speed = 0.5

        def steer(self, wanted, before, position, state, normals):
            return 0.5 * wanted

    register_kinematics("test-half", Half(), replace=True)
    _, window = fly("f2", kinematics="test-half")
    np.testing.assert_allclose(np.linalg.norm(window.velocity, axis=-1), 0.5, atol=1e-5)

    with pytest.raises(NotImplementedError, match="must define steer"):
        fly(kinematics=Kinematics())
    with pytest.raises(ArgumentError, match="model must be a Kinematics"):
        register_kinematics("test-x", 3)
