"""The GRU cell, held against equations (26) to (29) written out number by number."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mc_gassl_inputs import parameters, random_inputs

from detectors.mc_gassl.gru import gru


def literal_cell(weights, h, v):
    """One cell with scalars only; ``weights`` are W_r, W_u, W_h as nested lists."""
    w_r, w_u, w_h = weights
    both = [*h, *v]
    g_r = [1 / (1 + math.exp(-sum(a * b for a, b in zip(row, both, strict=True)))) for row in w_r]
    g_u = [1 / (1 + math.exp(-sum(a * b for a, b in zip(row, both, strict=True)))) for row in w_u]
    reset = [*v, *(g * x for g, x in zip(g_r, h, strict=True))]
    new = [math.tanh(sum(a * b for a, b in zip(row, reset, strict=True))) for row in w_h]
    return [(1 - g) * x + g * y for g, x, y in zip(g_u, h, new, strict=True)]


def literal(weights, h, velocity):
    for v in velocity:
        h = literal_cell(weights, h, v)
    return h


@settings(max_examples=25, deadline=None)
@given(memory=st.integers(1, 5), seed=st.integers(0, 10_000))
def test_the_network_is_the_equations_one_after_another(memory, seed):
    weights = parameters(seed)
    inputs = random_inputs(times=2, uavs=3, memory=memory, seed=seed)
    features = gru(weights, inputs.position, inputs.velocity)
    rows = [tensor.tolist() for tensor in weights.tensors()]
    for t in range(2):
        for i in range(3):
            x, y, z = inputs.position[t, i].tolist()
            want = literal(rows, [x / 1000, y / 1000, z / 100], inputs.velocity[t, i].tolist())
            assert features[t, i].tolist() == pytest.approx(want, abs=1e-12)
