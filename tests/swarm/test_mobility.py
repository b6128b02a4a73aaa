"""Mobility of heads, each law by its statistics; kinematics, each model by what it allows and its definition."""

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
from usnet_env.swarm.kinematics import Lagged, Layered, Limited, VariedSpeed

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
def test_jitter_gives_heads_the_followers_noise(noise):
    follow = replace(FOLLOW_STRATEGIES["f1"], noise=noise)
    state, window = fly(follow, mobility="straight", head_jitter=True, uavs=9, observation_steps=2000)
    velocity = flown(window)[0][:, state.head]
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
    with pytest.raises(ArgumentError, match="model must be a Mobility or a function"):
        register_mobility("test-x", 3)
    register_mobility("test-short", lambda rng, position, steps, state: np.zeros((1, 3)), replace=True)
    with pytest.raises(ValueError, match="reshape"):
        tracks("test-short")


KINDS = ["unit", "varied_speed", "lagged", "limited", "layered"]


@pytest.mark.parametrize("follow", ["f2", "f6", "f7", "none"])
@pytest.mark.parametrize("name", KINDS)
def test_positions_integrate_velocities_and_bounds_hold(name, follow):
    state, window = fly(follow, kinematics=name, mobility="gauss_markov", bystanders=2, traffic=3)
    np.testing.assert_allclose(np.diff(window.position, axis=1), window.velocity, atol=3e-4)
    model = KINEMATICS[name]
    assert np.linalg.norm(window.velocity, axis=-1).max() <= model.top_speed * 1.001
    assert state.kinematic_state.shape == (24, model.values)


class SlowVariedSpeed(VariedSpeed):
    fly = Kinematics.fly

    def steer(self, wanted, before, position, state, normals):
        push = self.sigma * np.sqrt(1 - self.phi**2)
        state[:, 1] = self.phi * state[:, 1] + push * normals[:, 0]
        return wanted * np.clip(state[:, 0] * (1 + state[:, 1]), self.slowest, self.fastest)[:, None]


class SlowLagged(Lagged):
    fly = Kinematics.fly

    def steer(self, wanted, before, position, state, normals):
        return before + (wanted - before) * state


class SlowLimited(Limited):
    fly = Kinematics.fly

    def steer(self, wanted, before, position, state, normals):
        speed = np.linalg.norm(before, axis=1)
        course = before / np.maximum(speed, 1e-6)[:, None]
        cosine = np.clip((course * wanted).sum(axis=1), -1.0, 1.0)
        angle = np.minimum(np.arccos(cosine), state[:, 0])
        across = wanted - cosine[:, None] * course
        level = np.stack([-course[:, 1], course[:, 0], np.zeros_like(cosine)], axis=1)
        across = unit(np.where(np.linalg.norm(across, axis=1, keepdims=True) < 1e-4, level, across))
        turned = unit(np.cos(angle)[:, None] * course + np.sin(angle)[:, None] * across)
        goal = self.slowest + (1.0 - self.slowest) * 0.5 * (1.0 + cosine)
        now = np.clip(goal, speed - self.acceleration, speed + self.acceleration)
        return turned * np.clip(now, 0.0, 1.0)[:, None]


class SlowLayered(Layered):
    fly = Kinematics.fly

    def steer(self, wanted, before, position, state, normals):
        vertical = np.clip((state[:, 0] - position[:, 2]) / 10.0, -self.climb, self.climb)
        return np.column_stack([unit(wanted[:, :2]) * np.sqrt(1.0 - vertical**2)[:, None], vertical])


@pytest.mark.parametrize("slow", [SlowVariedSpeed, SlowLagged, SlowLimited, SlowLayered])
def test_compiled_flight_equals_its_definition(slow):
    """Step by step from the same states: the flight of 200 UAVs over 20 steps."""
    rng = np.random.default_rng(3)
    models = slow.__base__(), slow()
    state = [np.stack([models[0].start(np.random.default_rng(b), 100) for b in range(2)]) for _ in models]
    motion = rng.choice(np.array([0, 1, 2], np.int8), (2, 100))
    position = rng.uniform(0, 100, (2, 22, 100, 3)).astype(np.float32)
    velocity = unit(rng.standard_normal((2, 21, 100, 3))).astype(np.float32)
    flights = [(position.copy(), velocity.copy()) for _ in models]
    for t in range(1, 21):
        normals = rng.standard_normal((2, 100, models[0].normals), dtype=np.float32)
        for model, kept, flight in zip(models, state, flights, strict=True):
            model.fly(t, motion, normals, kept, *flight)
    np.testing.assert_allclose(flights[0][1], flights[1][1], atol=2e-4)
    living = np.broadcast_to((motion > 0)[:, None], (2, 22, 100))
    np.testing.assert_allclose(flights[0][0][living], flights[1][0][living], atol=2e-3)
    np.testing.assert_allclose(state[0][motion > 0], state[1][motion > 0], atol=1e-5)


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
