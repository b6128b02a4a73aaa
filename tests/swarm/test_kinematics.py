"""Kinematics: each model by what it allows, against its definition in NumPy, and as a user registers one."""

import numpy as np
import pytest
from flights import fly, turns, unit

from usnet_env import ArgumentError
from usnet_env.swarm import KINEMATICS, Kinematics, register_kinematics
from usnet_env.swarm.kinematics import Lagged, Layered, Limited, VariedSpeed

NAMES = ["unit", "varied_speed", "lagged", "limited", "layered"]


@pytest.mark.parametrize("follow", ["f2", "f6", "f7", "none"])
@pytest.mark.parametrize("name", NAMES)
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


@pytest.mark.parametrize("mobility", ["iid", "local_waypoint"])
def test_no_uav_turns_or_accelerates_beyond_its_limit(mobility):
    state, window = fly("f3", kinematics="limited", mobility=mobility, rounds=2)
    velocity = window.velocity[0].astype(float)
    assert (turns(velocity) <= state.kinematic_state[:, 0] + 2e-3).all()
    speed = np.linalg.norm(velocity, axis=-1)
    assert np.abs(np.diff(speed, axis=0)).max() <= Limited().acceleration + 1e-4
    assert speed.max() <= 1.0 + 1e-5


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
