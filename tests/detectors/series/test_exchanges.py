"""Exchanged identities: tracks are joined again where two UAVs jump, and nowhere else."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from detectors.series.exchanges import undo_exchanges
from usnet_env import Window
from usnet_env.evaluation import evaluate_suite


def fly(seed, uavs=8, steps=60, spread=40.0):
    """Tracks ``(T + 1, N, 3)`` of UAVs with steps of about 1 m, so many metres apart."""
    rng = np.random.default_rng(seed)
    turns = rng.normal(0, 1, (steps, uavs)).cumsum(axis=0)
    steps = np.stack([np.cos(turns), np.sin(turns), 0 * turns], axis=2) * rng.uniform(0.8, 1.2, (steps, uavs, 1))
    return rng.uniform(0, spread, (1, uavs, 3)) + np.concatenate([0 * steps[:1], steps.cumsum(axis=0)])


def watch(position, seen=None, sample_every=1):
    seen = np.ones(position.shape[:2], bool) if seen is None else seen
    velocity = np.diff(position, axis=0) * (seen[1:] & seen[:-1])[..., None] / sample_every
    return Window(position * seen[..., None], velocity, seen, np.ones(position.shape[1]))


@given(seed=st.integers(0, 2**32 - 1), exchanges=st.integers(1, 6), sample_every=st.integers(1, 3))
def test_far_exchanges_are_undone(seed, exchanges, sample_every):
    rng, position = np.random.default_rng(seed), fly(seed)
    seen = rng.random(position.shape[:2]) < 0.95
    window = watch(position, seen, sample_every)
    spoiled, hidden = window.position.copy(), window.seen.copy()
    for t in np.sort(rng.choice(np.arange(1, 60), exchanges, replace=False)):
        here = np.flatnonzero(hidden[t - 1] & hidden[t])
        apart = np.linalg.norm(spoiled[t][here, None] - spoiled[t][here], axis=2)
        first, second = np.unravel_index(apart.argmax(), apart.shape)  # far enough to jump
        pair = here[[first, second]]
        spoiled[t:, pair], hidden[t:, pair] = spoiled[t:, pair[::-1]], hidden[t:, pair[::-1]]
    restored = undo_exchanges(watch(spoiled, hidden, sample_every))
    assert (restored.seen == window.seen).all()
    assert np.allclose(restored.position, window.position)
    assert np.allclose(restored.velocity, window.velocity, atol=1e-5)


@given(seed=st.integers(0, 2**32 - 1), spread=st.sampled_from([0.1, 2.0, 40.0]))
def test_a_swarm_without_jumps_stays_as_it_is(seed, spread):
    window = watch(fly(seed, spread=spread))
    assert undo_exchanges(window) is window


def test_a_uav_that_jumps_alone_keeps_its_identity():
    position = fly(0)
    position[30:, 2] += 50.0
    window = watch(position)
    assert undo_exchanges(window) is window


def test_still_and_unseen_uavs_are_left_alone():
    still = watch(np.zeros((30, 3, 3)))
    assert undo_exchanges(still) is still
    exchanged = fly(0)
    exchanged[30:, [0, 1]] = exchanged[30:, [1, 0]]
    motionless = Window(exchanged, np.zeros((60, 8, 3)), np.ones((61, 8)), np.ones(8))
    assert not undo_exchanges(motionless).velocity[:29].any()
    unseen = watch(fly(0), np.zeros((61, 8), bool))
    assert undo_exchanges(unseen) is unseen


def test_reader_finds_the_heads_of_exchanged_tracks():
    result = evaluate_suite("limit", "reader(policy='map')", cells=["swaps"], episodes=10, seed=5)
    assert result.rows.exact.mean() >= 0.7
