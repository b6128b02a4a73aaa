"""Features of a window: shapes, masks, and the GRU network behind them."""

import numpy as np
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from mc_gassl_inputs import parameters

from detectors.mc_gassl.features import gru_features, inputs_of
from detectors.mc_gassl.gru import gru
from usnet_env import Window


@settings(max_examples=25, deadline=None)
@given(
    steps=st.integers(1, 12), uavs=st.integers(1, 7), memory=st.integers(1, 6), seed=st.integers(0, 1000)
)  # fmt: skip
def test_any_window_has_features(steps, uavs, memory, seed):
    rng = np.random.default_rng(seed)
    alive = rng.random(uavs) < 0.8
    seen = (rng.random((steps + 1, uavs)) < 0.7) & alive
    position = np.where(seen[..., None], rng.normal(0, 100, (steps + 1, uavs, 3)), 0)
    velocity = np.where((seen[:-1] & seen[1:])[..., None], rng.normal(0, 1, (steps, uavs, 3)), 0)
    window = Window(position, velocity, seen, alive)
    weights, inputs = parameters(dtype=torch.float32), inputs_of(window, memory)
    values = gru_features(window, weights, memory)
    times = max(steps - memory, 0) + 1
    newest = gru(weights, inputs.position, inputs.velocity)[-1].double().numpy()
    np.testing.assert_allclose(values, newest * alive[:, None], atol=1e-6)
    for r in range(times):
        for i in range(uavs):
            whole = window.velocity_seen[r : r + min(memory, steps), i].all()
            assert bool(inputs.seen[r, i]) == whole
