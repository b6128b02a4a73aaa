"""The GRU cell, held against equations (26) to (29) of one UAV, and the features of a window that it makes."""

import numpy as np
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from mc_gassl_inputs import parameters, random_inputs

from detectors.mc_gassl.features import compute_gru_features, make_inputs
from detectors.mc_gassl.gru import run_gru
from usnet_env import Window


def literal(weights, h, velocity):
    """The cells of one UAV; ``weights`` are W_r, W_u, W_h."""
    for v in velocity:
        g_r, g_u = (1 / (1 + np.exp(-w @ np.append(h, v))) for w in weights[:2])
        new = np.tanh(weights[2] @ np.append(v, g_r * h))
        h = (1 - g_u) * h + g_u * new
    return h


@settings(max_examples=25, deadline=None)
@given(memory=st.integers(1, 5), seed=st.integers(0, 10_000))
def test_the_network_is_the_equations_one_after_another(memory, seed):
    weights = parameters(seed)
    inputs = random_inputs(times=2, uavs=3, memory=memory, seed=seed)
    features = run_gru(weights, inputs.position, inputs.velocity)
    matrices = [tensor.numpy() for tensor in weights.tensors()]
    for t in range(2):
        for i in range(3):
            want = literal(matrices, inputs.position[t, i].numpy() / (1000, 1000, 100), inputs.velocity[t, i].numpy())
            np.testing.assert_allclose(features[t, i], want, atol=1e-12)


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
    weights, inputs = parameters(dtype=torch.float32), make_inputs(window, memory)
    values = compute_gru_features(window, weights, memory)
    times = max(steps - memory, 0) + 1
    newest = run_gru(weights, inputs.position, inputs.velocity)[-1].double().numpy()
    np.testing.assert_allclose(values, newest * alive[:, None], atol=1e-6)
    for r in range(times):
        for i in range(uavs):
            whole = window.velocity_seen[r : r + min(memory, steps), i].all()
            assert bool(inputs.seen[r, i]) == whole
