"""Features of a window: shapes, masks, and the GRU network behind them."""

from typing import get_args

import numpy as np
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from mc_gassl_inputs import parameters, swarm_window

from detectors.mc_gassl.features import Mode, gru_features, inputs_of
from detectors.mc_gassl.gru import embed
from usnet_env import Window


def weights(width=3):
    return parameters(width, dtype=torch.float32)


@settings(max_examples=25, deadline=None)
@given(
    steps=st.integers(1, 12), uavs=st.integers(1, 7), memory=st.integers(1, 6), seed=st.integers(0, 1000),
    mode=st.sampled_from(get_args(Mode)), width=st.integers(3, 5),
)  # fmt: skip
def test_any_window_has_features(steps, uavs, memory, seed, mode, width):
    rng = np.random.default_rng(seed)
    alive = rng.random(uavs) < 0.8
    seen = (rng.random((steps + 1, uavs)) < 0.7) & alive
    position = np.where(seen[..., None], rng.normal(0, 100, (steps + 1, uavs, 3)), 0)
    velocity = np.where((seen[:-1] & seen[1:])[..., None], rng.normal(0, 1, (steps, uavs, 3)), 0)
    window = Window(position, velocity, seen, alive)
    values = gru_features(window, weights(width), mode, memory)
    times = max(steps - memory, 0) + 1
    assert values.shape == ((uavs, times, width) if mode == "series" else (uavs, width))
    assert np.isfinite(values).all()
    assert not values[~alive].any()
    inputs = inputs_of(window, memory)
    for r in range(times):
        for i in range(uavs):
            whole = window.velocity_seen[r : r + min(memory, steps), i].all()
            assert bool(inputs.seen[r, i]) == whole


def test_the_modes_are_the_newest_the_mean_and_all_of_one_series():
    window, _ = swarm_window(uavs=20, clusters=3, observation_steps=30)
    series = gru_features(window, weights(), "series", scale=(500.0, 500.0, 50.0))
    want = embed(weights(), inputs_of(window), (500.0, 500.0, 50.0)).double().numpy().swapaxes(0, 1)
    np.testing.assert_array_equal(series, want)
    single = gru_features(window, weights(), "single", scale=(500.0, 500.0, 50.0))
    np.testing.assert_allclose(single, series[:, -1], atol=1e-6)
    mean = gru_features(window, weights(), "mean", scale=(500.0, 500.0, 50.0))
    np.testing.assert_allclose(mean, series.mean(axis=1), atol=1e-12)
