"""The GRU cell, held against equations (26) to (29) written out number by number."""

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from mc_gassl_inputs import generator, parameters, random_inputs

from detectors.mc_gassl.gru import GruParameters, draw_parameters, embed, gru
from usnet_env.config import ArgumentError


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


@pytest.mark.parametrize("width", [3, 5])
def test_gradients_are_those_of_finite_differences(width):
    inputs = random_inputs(times=2, uavs=2)

    def features(reset, update, candidate, position, velocity):
        return gru(GruParameters(reset, update, candidate), position, velocity)

    arguments = (*parameters(width).tensors(), inputs.position, inputs.velocity)
    assert torch.autograd.gradcheck(features, tuple(tensor.requires_grad_(True) for tensor in arguments))


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


def test_metres_saturate_the_gates_and_scaled_positions_do_not():
    inputs = random_inputs(uavs=200, dtype=torch.float32)
    inputs.position.mul_(200.0)
    weights = draw_parameters(generator()).trainable()
    for scale, flat in ((1.0, True), (1000.0, False)):
        # W_r acts through g_r alone: its gradient tells whether that gate is saturated.
        gradient = torch.autograd.grad(embed(weights, inputs, scale).sum(), weights.reset)[0].abs().mean()
        shifted = embed(weights, inputs, scale).abs().max()
        assert (shifted > 10.0) == flat
        assert gradient > 0


def test_a_random_start_is_its_generators_alone():
    before = torch.random.get_rng_state()
    one, two, other = (draw_parameters(generator(seed), 7) for seed in (1, 1, 2))
    for a, b, c in zip(one.tensors(), two.tensors(), other.tensors(), strict=True):
        assert a.shape == (7, 10)
        assert a.abs().max() <= 10**-0.5
        assert torch.equal(a, b)
        assert not torch.equal(a, c)
    assert torch.equal(before, torch.random.get_rng_state())


@pytest.mark.parametrize("shapes", [((3, 6), (3, 6), (3, 5)), ((2, 5), (2, 5), (2, 5)), ((3, 6), (4, 7), (3, 6))])
def test_parameters_of_other_shapes_are_refused(shapes):
    with pytest.raises(ArgumentError, match=r"parameters must be three arrays of one shape \(width, width \+ 3\)"):
        GruParameters(*(torch.zeros(shape) for shape in shapes))


def test_a_width_below_a_position_is_refused():
    with pytest.raises(ArgumentError, match="width"):
        draw_parameters(generator(), 2)
