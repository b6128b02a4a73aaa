"""What GASSL and neural-granger have in common: their answers, what these must not depend on, what is refused."""

import random

import numpy as np
import pytest
import torch
from single_cluster_windows import changed, cluster, clusters, named, same, without
from sklearn.base import clone

from detectors.gassl import Gassl
from detectors.neural_granger import NeuralGranger
from usnet_env import ArgumentError, Window, make_detector

FEW = {"steps": 5}  # where the candidates don't matter


@pytest.fixture(params=[Gassl, NeuralGranger])
def kind(request):
    return request.param


@pytest.fixture
def detector(kind):
    """Makes detectors."""

    def make(seed=0, **arguments):
        made = kind(**arguments)
        made.reset(seed)
        return made

    return make


@pytest.mark.parametrize("top_k", [1, 3, 50])
def test_the_top_k_are_named(detector, top_k):
    window, _ = cluster(followers=4)
    got = detector(top_k=top_k, **FEW).detect(window)
    assert got.candidates.sum() == min(top_k, 5)
    if top_k == 3:
        assert got.scores[got.candidates].min() >= got.scores[~got.candidates].max()


def test_destroyed_uavs_are_left_out(detector):
    window, head = cluster(followers=6)
    gone = [i for i in range(7) if i != head][1:3]
    got = detector(top_k=7, **FEW).detect(without(window, gone))
    assert not got.candidates[gone].any()
    assert got.candidates.sum() == 5
    assert (got.scores[gone] == 0).all()
    assert (got.attention[gone] == 0).all()
    assert (got.attention[:, gone] == 0).all()
    assert (got.leader[gone] == -1).all()
    assert not np.isin(got.leader, gone).any()
    np.testing.assert_allclose(np.delete(got.attention, gone, axis=0).sum(axis=1), 1.0, atol=1e-5)


def test_masked_values_are_not_read(detector):
    window, _ = cluster(followers=4, miss_rate=0.2)
    gone = without(window, [1])
    noise = np.random.default_rng(0)
    there = gone.seen & gone.alive
    dirty = changed(
        gone,
        position=np.where(there[..., None], gone.position, noise.normal(size=gone.position.shape)),
        velocity=np.where(gone.velocity_seen[..., None], gone.velocity, noise.normal(size=gone.velocity.shape)),
    )
    same(detector(**FEW).detect(gone), detector(**FEW).detect(dirty))


def test_a_living_uav_that_was_never_seen(kind, detector):
    window, head = cluster(followers=5)
    hidden = (head + 1) % 6
    seen = window.seen.copy()
    seen[:, hidden] = False
    there = seen[1:] & seen[:-1]
    unseen = changed(
        window,
        position=np.where(seen[..., None], window.position, 0),
        velocity=np.where(there[..., None], window.velocity, 0),
        seen=seen,
    )
    got = detector(steps=60 if kind is NeuralGranger else 5).detect(unseen)
    assert got.candidates.sum() == 1
    assert np.isfinite(got.attention).all()
    assert np.isfinite(got.scores).all()
    if kind is NeuralGranger:
        assert named([got]) == [head]


@pytest.mark.parametrize("alive", [1, 2])
def test_one_or_two_living_uavs_give_no_evidence(detector, alive):
    window, _ = cluster(followers=4)
    few = without(window, list(range(5 - alive)))
    picked = {int(named([detector(seed).detect(few)])[0]) for seed in range(20)}
    assert picked == set(range(5 - alive, 5))


def test_the_seed_decides(detector):
    windows, _ = clusters(2, followers=3)

    def answer(seed):
        made = detector(seed, **FEW)
        return [made.detect(window) for window in windows]

    first, second, other = answer(7), answer(7), answer(8)
    for one, two in zip(first, second, strict=True):
        same(one, two)
    assert any((one.attention != two.attention).any() for one, two in zip(first, other, strict=True))


def test_nothing_global_is_touched(kind):
    window, _ = cluster(followers=3)

    def world():
        state, keys, *rest = np.random.get_state()  # noqa: NPY002  the generator that must stay untouched
        return (
            torch.get_rng_state().tolist(),
            (state, keys.tolist(), rest),
            random.getstate(),
            torch.get_num_threads(),
            torch.get_num_interop_threads(),
            torch.get_default_dtype(),
            torch.is_grad_enabled(),
            torch.are_deterministic_algorithms_enabled(),
        )

    before = world()
    kept = window.position.copy(), window.velocity.copy()
    kind(**FEW).detect(window)  # without a reset it makes its own generator
    assert world() == before
    np.testing.assert_array_equal(window.position, kept[0])
    np.testing.assert_array_equal(window.velocity, kept[1])


@pytest.mark.parametrize("name", ["gassl(rule='exclude-self', learning_rate=0.01)", "neural-granger(gate=True)"])
def test_arguments_are_stored_and_cloned(name):
    made = make_detector(name, steps=3, top_k=2)
    arguments = made.get_params()
    assert (arguments["steps"], arguments["top_k"]) == (3, 2)
    assert arguments.get("rule") == "exclude-self" or arguments.get("gate") is True
    copy = clone(made)
    assert copy.get_params() == arguments
    assert copy.set_params(top_k=3).top_k == 3
    assert made.top_k == 2
    assert "rng" not in vars(made)
    made.reset(0)
    assert made.detect(cluster(followers=3)[0]).candidates.sum() == 2


COMMON = [
    {"top_k": 0},
    {"top_k": 1.5},
    {"top_k": True},
    {"memory": 0},
    {"memory": "4"},
    {"steps": 0},
    {"steps": "many"},
    {"learning_rate": 0.0},
    {"learning_rate": float("inf")},
    {"learning_rate": float("nan")},
]
OWN = {
    Gassl: [
        {"rule": "argmax"},
        {"rule": ""},
        {"rule": ["paper"]},
        {"implementation": "fast"},
        {"ifsn_hidden": 0},
        {"ifsn_hidden": (8, 8)},
        {"similarity_hidden": (8, 8, 8)},
        {"query_hidden": 0},
        {"query": 0},
        {"key": -1},
        {"gain": 0.0},
    ],
    NeuralGranger: [
        {"gate": 1},
        {"gate_threshold": -0.1},
        {"gate_threshold": float("nan")},
        {"gate_threshold": "high"},
        {"device": "tpu"},
        {"device": 0},
        {"times": 2.5},
        {"weight_decay": -1.0},
        {"voters": 1, "input_noise": None},
        {"units": 0},
        {"blocks": 0},
        {"ridge": 0.0},
        {"floor": -1.0},
    ],
}


@pytest.mark.parametrize(("made", "arguments"), [(made, bad) for made, own in OWN.items() for bad in COMMON + own])
def test_an_argument_is_refused_in_one_sentence(made, arguments):
    window, _ = cluster(followers=2)
    for act in (lambda: made(**arguments).reset(0), lambda: made(**arguments).detect(window)):
        with pytest.raises(ArgumentError) as refused:
            act()
        sentence = str(refused.value)
        assert sentence.startswith(f"{next(iter(arguments))} must ")
        assert sentence.endswith(".")
        assert "\n" not in sentence
        assert "got " in sentence


def test_a_window_that_is_too_short_is_refused(detector):
    window, _ = cluster(followers=4)
    short = changed(window, position=window.position[:5], velocity=window.velocity[:4], seen=window.seen[:5])
    made = detector()
    for act in (lambda: made.detect(short), lambda: made.detect_batch([window, short])):
        with pytest.raises(ArgumentError, match=r"^window must hold more than memory = 4 velocities, got 4\.$"):
            act()


def test_windows_that_show_nothing(detector):
    window, _ = cluster(followers=4)
    two = changed(
        window, position=window.position[:, :2], velocity=window.velocity[:, :2], seen=window.seen[:, :2], alive=[1, 1]
    )
    unseen = changed(window, seen=np.zeros_like(window.seen))
    for poor in (two, unseen):
        answer = detector(top_k=2).detect(poor)
        assert answer.candidates.sum() == 2
        assert not answer.scores.any()
    answer = detector().detect(without(window, list(range(5))))
    assert not answer.candidates.any()


@pytest.mark.parametrize("steps", [5, 6, 12])
def test_the_shortest_windows(detector, steps):
    window, _ = cluster(followers=2)
    short = Window(
        window.position[: steps + 1], window.velocity[:steps], window.seen[: steps + 1], window.alive, window.round
    )
    got = detector(**FEW).detect(short)
    assert got.candidates.sum() == 1
    assert np.isfinite(got.extras["explained"]).all()


@pytest.mark.slow
def test_five_hundred_uavs(detector):
    window, _ = cluster(followers=499)
    got = detector(steps=2).detect(window)
    assert got.attention.shape == (500, 500)
    assert got.candidates.sum() == 1
