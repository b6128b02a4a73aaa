"""The GRU cell, held against equations (26) to (29) written out number by number."""

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from mc_gassl_inputs import parameters, random_inputs

from detectors.mc_gassl.gru import GruParameters, embed, gru


def literal_cell(weights, h, v):
    """One cell with scalars only; ``weights`` are W_r, W_u, W_h as nested lists."""
    w_r, w_u, w_h = weights
    both = [*h, *v]
    g_r = [1 / (1 + math.exp(-sum(a * b for a, b in zip(row, both, strict=True)))) for row in w_r]
    g_u = [1 / (1 + math.exp(-sum(a * b for a, b in zip(row, both, strict=True)))) for row in w_u]
    reset = [*v, *(g * x for g, x in zip(g_r, h, strict=True))]
    new = [math.tanh(sum(a * b for a, b in zip(row, reset, strict=True))) for row in w_h]
    return [(1 - g) * x + g * y for g, x, y in zip(g_u, h, new, strict=True)]


def literal(weights, first, velocity, width):
    h = [*first, *[0.0] * (width - 3)]
    for v in velocity:
        h = literal_cell(weights, h, v)
    return h


@settings(max_examples=25, deadline=None)
@given(width=st.integers(3, 6), memory=st.integers(1, 5), seed=st.integers(0, 10_000))
def test_the_network_is_the_equations_one_after_another(width, memory, seed):
    weights = parameters(width, seed)
    inputs = random_inputs(times=2, uavs=3, memory=memory, seed=seed)
    features = embed(weights, inputs, scale=(2.0, 3.0, 0.5))
    rows = [tensor.tolist() for tensor in weights.tensors()]
    for t in range(2):
        for i in range(3):
            x, y, z = inputs.position[t, i].tolist()
            want = literal(rows, [x / 2.0, y / 3.0, z / 0.5], inputs.velocity[t, i].tolist(), width)
            assert features[t, i].tolist() == pytest.approx(want, abs=1e-12)


def test_the_reset_gate_acts_before_the_weights():
    """``torch.nn.GRU`` resets what W_h has made of h instead; the two differ on the same weights."""
    weights = parameters(3, 1)
    w_r, w_u, w_h = weights.tensors()
    inputs = random_inputs(times=1, uavs=6, memory=1)
    theirs = torch.nn.GRUCell(3, 3, bias=False, dtype=torch.float64)
    with torch.no_grad():
        # Theirs mixes (1 - z) n + z h, so z is 1 - g_u.
        theirs.weight_ih.copy_(torch.cat([w_r[:, 3:], -w_u[:, 3:], w_h[:, :3]]))
        theirs.weight_hh.copy_(torch.cat([w_r[:, :3], -w_u[:, :3], w_h[:, 3:]]))
        other = theirs(inputs.velocity[0, :, 0], inputs.position[0])
        ours = gru(weights, inputs.position[0], inputs.velocity[0])
    assert (ours - other).abs().max() > 0.05
    diagonal = GruParameters(w_r, w_u, torch.cat([w_h[:, :3], torch.diag(w_h.diagonal())], dim=1))
    with torch.no_grad():  # where W_h mixes no entries of h, both are the same
        theirs.weight_hh.copy_(torch.cat([w_r[:, :3], -w_u[:, :3], torch.diag(w_h.diagonal())]))
        other = theirs(inputs.velocity[0, :, 0], inputs.position[0])
        torch.testing.assert_close(gru(diagonal, inputs.position[0], inputs.velocity[0]), other)
