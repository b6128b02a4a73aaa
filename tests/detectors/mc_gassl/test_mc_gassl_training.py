"""The meta step, joint training and on-line training, held against finite differences of the loss."""

import pytest
import torch
from mc_gassl_inputs import clustered, generator, parameters

from detectors.mc_gassl.gru import GruParameters
from detectors.mc_gassl.training_steps import OnlineTraining, Task, take_meta_step, train_online
from detectors.mc_gassl.triplet import Metric, compute_batch_loss

# Every hinge is far from its kink, so that differences are derivatives; the triplets don't depend on the weights.
SMOOTH = Metric(margin=5.0, times=3, anchors=10)


def task(seed=0):
    return Task(clustered(seed=seed), clustered(seed=seed + 100))


def numerical_gradient(loss, at, step=1e-6):
    """d loss / d at by central differences, entry by entry."""
    gradients = []
    for k, tensor in enumerate(at.tensors()):
        gradient = torch.zeros_like(tensor)
        for index in torch.cartesian_prod(*(torch.arange(length) for length in tensor.shape)):
            ends = []
            for sign in (1.0, -1.0):
                moved = [array.clone() for array in at.tensors()]
                moved[k][tuple(index)] += sign * step
                ends.append(float(loss(GruParameters(*moved))))
            gradient[tuple(index)] = (ends[0] - ends[1]) / (2.0 * step)
        gradients.append(gradient)
    return gradients


def less(at, rate, gradients):
    return GruParameters(*(tensor - rate * g for tensor, g in zip(at.tensors(), gradients, strict=True)))


def assert_equal_parameters(one, two, tolerance=0.0):
    for a, b in zip(one.tensors(), two.tensors(), strict=True):
        torch.testing.assert_close(a, b, rtol=0.0, atol=tolerance)
        assert not a.requires_grad


def losses_of(drawn, metric, own):
    """Support and query loss as functions of the weights, on the batches that a step draws from ``own``."""
    functions = []
    for swarm in (drawn.support, drawn.query):
        state = own.get_state()

        def loss(at, swarm=swarm, state=state):
            return compute_batch_loss(at, swarm.inputs, swarm.labels, metric, generator().set_state(state))

        functions.append(loss)
        compute_batch_loss(parameters(), swarm.inputs, swarm.labels, metric, own)  # moves ``own`` on to the next batch
    return functions


def test_the_meta_step_is_equations_35_and_36_to_first_order():
    drawn, at = task(), parameters()
    support, query = losses_of(drawn, SMOOTH, generator(5))
    temporary = less(at, 0.3, numerical_gradient(support, at))
    want = less(at, 0.2, numerical_gradient(query, temporary))
    found, loss = take_meta_step(at, drawn, SMOOTH, 0.3, 0.2, generator(5))
    assert_equal_parameters(found, want, 1e-7)
    assert loss == pytest.approx(float(query(temporary)), abs=1e-7)
    # neither a plain step from W, nor one from the temporary parameters, nor the whole derivative through both steps
    plain = less(at, 0.2, numerical_gradient(query, at))
    from_temporary = less(temporary, 0.2, numerical_gradient(query, temporary))
    whole_gradient = torch.autograd.grad(through_both(support, query, at, 0.3), at.tensors())
    for other in (plain, from_temporary, less(at, 0.2, whole_gradient)):
        assert max((a - b).abs().max() for a, b in zip(found.tensors(), other.tensors(), strict=True)) > 1e-3


def through_both(support, query, at, rate):
    """L_Q(W - alpha grad L_S(W)) with its whole graph: second-order meta learning."""
    for tensor in at.tensors():
        tensor.requires_grad_(True)
    gradients = torch.autograd.grad(support(at), at.tensors(), create_graph=True)
    return query(less(at, rate, gradients))


def separable(seed=0):
    """Clusters whose UAVs share their velocities but for a little noise, at positions that tell nothing."""
    swarm = clustered(times=30, uavs=12, clusters=3, seed=seed)
    velocity = swarm.inputs.velocity
    velocity[:, :] = velocity[:, swarm.labels] + 0.05 * velocity[:, torch.arange(12).roll(1)]
    swarm.inputs.position.mul_(0.2)
    return swarm


def test_online_training_parts_the_clusters():
    swarm = separable()
    at = parameters(spread=0.3)
    kept = GruParameters(*map(torch.clone, at.tensors()))
    settings = OnlineTraining(steps=80, rate=0.5, metric=Metric())
    before = torch.random.get_rng_state()
    _, losses = train_online(at, swarm.inputs, swarm.labels, settings, generator(1))
    assert len(losses) == 80
    assert sum(losses[-10:]) < 0.5 * sum(losses[:10])
    assert_equal_parameters(at, kept)
    shorter = settings._replace(steps=5)
    again, same = (train_online(at, swarm.inputs, swarm.labels, shorter, generator(1)) for _ in range(2))
    assert again[1] == same[1] == losses[:5]
    assert_equal_parameters(again[0], same[0])
    assert torch.equal(before, torch.random.get_rng_state())


@pytest.mark.parametrize("labels", [[0] * 9, list(range(9)), [-1] * 9])
def test_online_training_without_a_triplet_changes_nothing(labels):
    at = parameters()
    found, losses = train_online(
        at, clustered().inputs, torch.tensor(labels), OnlineTraining(3, 1.0, SMOOTH), generator()
    )
    assert_equal_parameters(found, at)
    assert losses == [0.0, 0.0, 0.0]
