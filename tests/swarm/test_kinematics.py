"""Kinematics: each model by what it allows, against its definition, and as a user registers one."""

import numpy as np
import pytest

from usnet_env import ArgumentError
from usnet_env.envs import MultiClusterEnv
from usnet_env.swarm import Kinematics, SwarmConfig, advance, destroy, kinematics_models, register_kinematics, start
from usnet_env.swarm.kinematics import KINEMATICS, Layered, Limited

NAMES = ["unit", "varied_speed", "lagged", "limited", "layered"]


@pytest.fixture
def registry(monkeypatch):
    monkeypatch.setattr(KINEMATICS, "_registered", {})


def fly(kinematics, rounds=1, **arguments):
    """The last of some windows of a swarm, and the state at its end."""
    config = SwarmConfig(**{"kinematics": kinematics, "clusters": 3, "uavs": 30, **arguments})
    rngs = [np.random.default_rng(0)]
    state = start(config, rngs)
    for _ in range(rounds):
        state, window = advance(config, state, rngs)
    return window, state


def turns(velocity):
    course = velocity / np.linalg.norm(velocity, axis=-1, keepdims=True)
    return np.arccos(np.clip((course[1:] * course[:-1]).sum(axis=-1), -1, 1))


def test_the_default_is_unit():
    assert set(NAMES) <= set(kinematics_models())
    one, other = fly("unit", follow="f6")[0], fly(KINEMATICS["unit"], follow="f6")[0]
    np.testing.assert_array_equal(one.velocity, other.velocity)
    assert SwarmConfig().kinematics == "unit"


@pytest.mark.parametrize("follow", ["f2", "f6", "f7", "none"])
@pytest.mark.parametrize("name", NAMES)
def test_positions_integrate_velocities_and_bounds_hold(name, follow):
    window, state = fly(name, follow=follow, mobility="gauss_markov", bystanders=2, traffic=3)
    np.testing.assert_allclose(np.diff(window.position, axis=1), window.velocity, atol=3e-4)
    model = KINEMATICS[name]
    assert np.linalg.norm(window.velocity, axis=-1).max() <= model.top_speed * 1.001
    assert state.kinematic_state.shape == (1, 30, model.values)


@pytest.mark.parametrize("name", [name for name in NAMES if name != "unit"])
def test_compiled_flight_equals_its_definition(name):
    """Step by step from the same states: the flight of 200 UAVs over 20 steps."""
    model, rng = KINEMATICS[name], np.random.default_rng(3)
    state = [np.stack([model.start(np.random.default_rng(b), 100) for b in range(2)]) for _ in range(2)]
    motion = rng.choice(np.array([0, 1, 2], np.int8), (2, 100))
    position = rng.uniform(0, 100, (2, 22, 100, 3)).astype(np.float32)
    velocity = rng.standard_normal((2, 21, 100, 3)).astype(np.float32)
    velocity /= np.linalg.norm(velocity, axis=-1, keepdims=True)
    flights = [(position.copy(), velocity.copy()) for _ in range(2)]
    for t in range(1, 21):
        normals = rng.standard_normal((2, 100, model.normals), dtype=np.float32)
        model.fly(t, motion, normals, state[0], *flights[0])
        Kinematics.fly(model, t, motion, normals, state[1], *flights[1])
    np.testing.assert_allclose(flights[0][1], flights[1][1], atol=2e-4)
    living = np.broadcast_to((motion > 0)[:, None], (2, 22, 100))
    np.testing.assert_allclose(flights[0][0][living], flights[1][0][living], atol=2e-3)
    np.testing.assert_allclose(state[0][motion > 0], state[1][motion > 0], atol=1e-5)


def test_speeds_vary_between_uavs_and_over_time():
    window, _ = fly("varied_speed", observation_steps=400)
    speed = np.linalg.norm(window.velocity[0], axis=-1).astype(float)
    assert speed.min() >= 0.5 - 1e-4
    assert 0.08 < speed.mean(axis=0).std() < 0.2
    relative = speed / speed.mean(axis=0) - 1
    assert (relative[1:] * relative[:-1]).mean() / (relative**2).mean() == pytest.approx(0.95, abs=0.05)


def test_lagged_velocities_approach_what_is_wanted():
    window, state = fly("lagged", follow="none", mobility="straight", rounds=2)
    np.testing.assert_allclose(np.linalg.norm(window.velocity, axis=-1), 1.0, atol=1e-3)
    smooth, state = fly("lagged", follow="none", mobility="iid", observation_steps=2000)
    product = (smooth.velocity[0, 1:] * smooth.velocity[0, :-1]).sum(axis=-1).mean(axis=0)
    keep = product / (smooth.velocity[0] ** 2).sum(axis=-1).mean(axis=0)
    np.testing.assert_allclose(keep, 1 - state.kinematic_state[0, :, 0], atol=0.1)
    assert 1 / 4 - 1e-6 <= state.kinematic_state.min() <= state.kinematic_state.max() <= 1 / 1.5 + 1e-6


@pytest.mark.parametrize("mobility", ["iid", "local_waypoint"])
def test_no_uav_turns_or_accelerates_beyond_its_limit(mobility):
    window, state = fly("limited", follow="f3", mobility=mobility, rounds=2)
    velocity = window.velocity[0].astype(float)
    assert (turns(velocity) <= state.kinematic_state[0, :, 0] + 2e-3).all()
    speed = np.linalg.norm(velocity, axis=-1)
    assert np.abs(np.diff(speed, axis=0)).max() <= Limited().acceleration + 1e-4
    assert speed.max() <= 1.0 + 1e-5


def test_uavs_climb_to_their_layers_and_stay_there():
    window, state = fly("layered", mobility="gauss_markov", observation_steps=600)
    layer = state.kinematic_state[0, :, 0]
    assert set(np.unique(layer)) <= {10.0, 30.0, 50.0, 70.0, 90.0}
    np.testing.assert_allclose(window.position[0, -1, :, 2], layer, atol=0.1)
    assert np.abs(window.velocity[..., 2]).max() <= Layered().climb + 1e-5
    np.testing.assert_allclose(np.linalg.norm(window.velocity, axis=-1), 1.0, atol=1e-4)


def test_waypoints_are_reached_with_limited_turns():
    """A mobility knows where its UAV is, so a UAV that can't turn at once still flies to its waypoints."""
    window, _ = fly("limited", follow="none", mobility="waypoint", rounds=30, observation_steps=200)
    assert (window.position > -200).all()
    assert (window.position < np.array([1200, 1200, 300])).all()


@pytest.mark.parametrize("name", NAMES[1:])
def test_episode_b_of_a_batch_is_the_single_swarm(name):
    config = SwarmConfig(
        kinematics=name, clusters=3, uavs=60, decoys=2, bystanders=3, traffic=2, follow="f6", mobility="smooth_turn"
    )
    rngs = [np.random.default_rng(seed) for seed in range(60)]
    batch = start(config, rngs)
    alone = [np.random.default_rng(47)]
    single = start(config, alone)
    candidates = np.zeros((60, 60), bool)
    for b in range(60):
        candidates[b, np.flatnonzero(batch.head[b])[:1]] = candidates[b, :7:3] = True
        candidates[b, np.flatnonzero(batch.head[b])[1]] = False
    for _ in range(2):
        batch, windows = advance(config, batch, rngs)
        single, window = advance(config, single, alone)
        np.testing.assert_array_equal(windows.position[47], window.position[0])
        np.testing.assert_array_equal(windows.velocity[47], window.velocity[0])
        batch, single = destroy(batch, candidates), destroy(single, candidates[47:48])
        assert not window.velocity[0][:, ~window.alive[0]].any()
    for key, array in single.arrays().items():
        np.testing.assert_array_equal(batch.arrays()[key][47], array[0], err_msg=key)


def test_observations_stay_in_their_space():
    env = MultiClusterEnv(kinematics="varied_speed", clusters=2, uavs=12, max_rounds=3, mobility="straight")
    observation, _ = env.reset(seed=0)
    assert env.observation_space.contains(observation)
    assert np.abs(observation["velocity"]).max() > 1.05
    for _ in range(2):
        observation, *_ = env.step(np.zeros(12, np.int8))
        assert env.observation_space.contains(observation)


def test_a_registered_model_is_used_by_name(registry):
    class Half(Kinematics):
        top_speed = 0.5

        def steer(self, wanted, before, position, state, normals):
            return 0.5 * wanted

    register_kinematics("half", Half())
    window, _ = fly("half", follow="f2")
    np.testing.assert_allclose(np.linalg.norm(window.velocity, axis=-1), 0.5, atol=1e-5)

    class Fast(Half):
        def steer(self, wanted, before, position, state, normals):
            return wanted

    with pytest.raises(ArgumentError, match=r"kinematics must return velocities of shape .* at most 0\.5 m per step"):
        fly(Fast())
    with pytest.raises(ArgumentError, match=r"kinematics must be one of .*did you mean 'lagged'"):
        SwarmConfig(kinematics="laged")
    with pytest.raises(ArgumentError, match="model must be a Kinematics, got 3"):
        register_kinematics("x", 3)
    with pytest.raises(ArgumentError, match="name must be a new one, got 'unit'"):
        register_kinematics("unit", Half())
