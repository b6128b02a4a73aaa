"""GASSL as a detector: its candidates, what it must not depend on, and what it refuses."""

import random

import numpy as np
import pytest
import torch
from gassl_windows import changed, cluster, clusters, named, without
from sklearn.base import clone

from detectors.gassl import Gassl
from usnet_env import ArgumentError, Window, evaluate, make_detector

FEW = {"steps": 5}  # where the candidates don't matter


def detector(seed=0, **arguments):
    made = Gassl(**arguments)
    made.reset(seed)
    return made


def detect_each(windows, **arguments):
    made = detector(**arguments)
    return [made.detect(window) for window in windows]


def rate(found, heads):
    return float((named(found) == heads).mean())


def same(one, two):
    for name in ("candidates", "scores", "leader", "attention"):
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name))
    assert one.extras.keys() == two.extras.keys()
    for name, value in one.extras.items():
        np.testing.assert_array_equal(value, two.extras[name])


# candidates


@pytest.mark.parametrize(
    ("count", "followers"), [(4, 5), *(pytest.param(10, n, marks=pytest.mark.slow) for n in (5, 10))]
)
def test_finds_the_head(count, followers):
    windows, heads = clusters(count, follow="f1", followers=followers)
    assert rate(detect_each(windows), heads) >= 0.8


@pytest.mark.parametrize("count", [4, pytest.param(10, marks=pytest.mark.slow)])
def test_finds_the_head_if_samples_are_missing(count):
    windows, heads = clusters(count, follow="f1", followers=5, miss_rate=0.1)
    assert rate(detect_each(windows), heads) >= 0.6  # 0.17 by chance


@pytest.mark.parametrize("count", [4, pytest.param(10, marks=pytest.mark.slow)])
def test_no_index_is_favoured(count):
    """The head is found at whatever index it is, and without evidence all indices are named alike."""
    windows, heads = clusters(count, follow="f1", followers=5)
    order = np.array([2, 0, 5, 3, 1, 4])
    turned = [
        changed(w, position=w.position[:, order], velocity=w.velocity[:, order], seen=w.seen[:, order]) for w in windows
    ]
    found = detect_each(turned)
    assert np.mean(order[named(found)] == heads) >= 0.8
    guesses, _ = clusters(90, follow="none", followers=2, observation_steps=12)
    counts = np.bincount(named(detect_each(guesses, steps=1)), minlength=3)
    assert (np.abs(counts - 30) < 5 * np.sqrt(30 * 2 / 3)).all()


def test_a_rule_without_votes_for_oneself_finds_the_head():
    windows, heads = clusters(4, follow="f1", followers=6)
    assert rate(detect_each(windows, rule="exclude-self"), heads) >= 0.8


# the shape of an answer


@pytest.mark.parametrize("rule", ["paper", "exclude-self"])
@pytest.mark.parametrize("memory", [4, 2])
def test_an_answer_is_made_of_the_attention(rule, memory):
    window, _ = cluster(followers=4)
    got = detector(rule=rule, memory=memory, **FEW).detect(window)
    assert got.candidates.shape == (5,)
    assert got.candidates.sum() == 1
    assert got.scores[got.candidates] == got.scores.max()
    np.testing.assert_allclose(got.attention.sum(axis=1), 1.0, atol=1e-5)
    others = got.attention - 2 * np.eye(5)
    np.testing.assert_array_equal(got.leader, others.argmax(axis=1))
    choice = got.attention.argmax(axis=1) if rule == "paper" else got.leader
    np.testing.assert_array_equal(got.extras["choice"], choice)
    votes = [sum(choice[other] == i for other in range(5) if other != i) / 5 for i in range(5)]  # equation (20)
    np.testing.assert_allclose(got.scores, votes)
    attn_heads = got.extras["attention_heads"]
    assert attn_heads.shape == (memory + 1, 5, 5)
    np.testing.assert_allclose(attn_heads.mean(axis=0), got.attention, atol=1e-6)  # equation (12)
    assert got.extras["loss"].shape == (5, 5)
    assert got.extras["explained"].shape == (5,)
    assert got.extras["explained"].max() <= 1


def test_votes_count_uavs_and_not_attention():
    """Attention that one UAV gets from a few UAVs must not outweigh the number of votes."""
    windows, _ = clusters(12, followers=6, observation_steps=20)
    for got in detect_each(windows, steps=30):
        votes = np.bincount(got.extras["choice"][got.extras["choice"] != np.arange(7)], minlength=7)
        assert votes[got.candidates] == votes.max()
        np.testing.assert_allclose(got.scores, votes / 7)


@pytest.mark.parametrize("top_k", [1, 3, 50])
def test_the_top_k_are_named(top_k):
    window, _ = cluster(followers=4)
    got = detector(top_k=top_k, **FEW).detect(window)
    assert got.candidates.sum() == min(top_k, 5)
    if top_k == 3:
        assert got.scores[got.candidates].min() >= got.scores[~got.candidates].max()


# masks


def test_destroyed_uavs_are_left_out():
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


def test_masked_values_are_not_read():
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


def test_a_living_uav_that_was_never_seen():
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
    got = detector(**FEW).detect(unseen)
    assert got.candidates.sum() == 1
    assert np.isfinite(got.attention).all()


@pytest.mark.parametrize("alive", [1, 2])
def test_one_or_two_living_uavs_give_no_evidence(alive):
    window, _ = cluster(followers=4)
    few = without(window, list(range(5 - alive)))
    picked = {int(named([detector(seed).detect(few)])[0]) for seed in range(20)}
    assert picked == set(range(5 - alive, 5))


# state


def test_the_seed_decides():
    windows, _ = clusters(2, followers=3)
    first, second = (detect_each(windows, seed=7, **FEW) for _ in range(2))
    for one, two in zip(first, second, strict=True):
        same(one, two)
    other = detect_each(windows, seed=8, **FEW)
    assert any((one.attention != two.attention).any() for one, two in zip(first, other, strict=True))


def test_nothing_but_the_generator_is_carried_from_window_to_window():
    """Whatever the first window shows, the second gets the same answer."""
    second, *firsts = (cluster(seed, followers=3)[0] for seed in range(3))
    one, two = (detect_each([first, second], **FEW)[1] for first in firsts)
    same(one, two)


def test_a_learning_rate_that_overflows_gives_even_attention():
    window, _ = cluster(followers=4)
    got = detector(learning_rate=1e30).detect(window)
    np.testing.assert_allclose(got.attention, 0.2, atol=1e-6)
    assert got.candidates.sum() == 1
    assert np.isfinite(got.scores).all()
    assert np.isfinite(got.extras["explained"]).all()
    assert np.isfinite(got.extras["attention_heads"]).all()


def test_nothing_global_is_touched():
    window, _ = cluster(followers=3)

    def world():
        kind, keys, *rest = np.random.get_state()  # noqa: NPY002  the generator that must stay untouched
        return (
            torch.get_rng_state().tolist(),
            (kind, keys.tolist(), rest),
            random.getstate(),
            torch.get_num_threads(),
            torch.is_grad_enabled(),
        )

    before = world()
    kept = window.position.copy(), window.velocity.copy()
    Gassl(**FEW).detect(window)  # without a reset it has a generator of its own
    assert world() == before
    np.testing.assert_array_equal(window.position, kept[0])
    np.testing.assert_array_equal(window.velocity, kept[1])


# arguments


def test_arguments_are_stored_and_cloned():
    made = Gassl(rule="exclude-self", top_k=2, ifsn_hidden=9, learning_rate=0.01)
    arguments = made.get_params()
    assert arguments["ifsn_hidden"] == 9
    copy = clone(made)
    assert copy.get_params() == arguments
    assert copy.set_params(top_k=3).top_k == 3
    assert made.top_k == 2
    assert "rng" not in vars(made)


def test_by_name():
    made = make_detector("gassl(rule='exclude-self', steps=3)", top_k=2)
    assert isinstance(made, Gassl)
    assert (made.rule, made.steps, made.top_k) == ("exclude-self", 3, 2)
    made.reset(0)
    assert made.detect(cluster(followers=3)[0]).candidates.sum() == 2


def test_it_is_evaluated():
    result = evaluate("USNET/SingleCluster-v0", "gassl", episodes=2, env_kwargs={"follow": "f1", "followers": 6})
    assert result["gassl"]["success"]["mean"] >= 0.5  # 0.14 by chance


@pytest.mark.parametrize(
    ("arguments", "argument"),
    [
        ({"rule": "argmax"}, "rule"),
        ({"rule": ""}, "rule"),
        ({"rule": ["paper"]}, "rule"),
        ({"top_k": 0}, "top_k"),
        ({"top_k": 1.5}, "top_k"),
        ({"top_k": True}, "top_k"),
        ({"implementation": "fast"}, "implementation"),
        ({"memory": 0}, "memory"),
        ({"memory": "4"}, "memory"),
        ({"steps": 0}, "steps"),
        ({"steps": "many"}, "steps"),
        ({"learning_rate": 0.0}, "learning_rate"),
        ({"learning_rate": float("inf")}, "learning_rate"),
        ({"learning_rate": float("nan")}, "learning_rate"),
        ({"ifsn_hidden": 0}, "ifsn_hidden"),
        ({"ifsn_hidden": (8, 8)}, "ifsn_hidden"),
        ({"similarity_hidden": (8, 8, 8)}, "similarity_hidden"),
        ({"query_hidden": 0}, "query_hidden"),
        ({"query": 0}, "query"),
        ({"key": -1}, "key"),
        ({"gain": 0.0}, "gain"),
    ],
)
def test_an_argument_is_refused_in_one_sentence(arguments, argument):
    window, _ = cluster(followers=2)
    for act in (lambda: Gassl(**arguments).reset(0), lambda: Gassl(**arguments).detect(window)):
        with pytest.raises(ArgumentError) as refused:
            act()
        sentence = str(refused.value)
        assert sentence.startswith(f"{argument} must ")
        assert sentence.endswith(".")
        assert "\n" not in sentence
        assert "got " in sentence


def test_a_window_that_is_too_short_is_refused():
    window, _ = cluster(followers=4)
    short = changed(window, position=window.position[:5], velocity=window.velocity[:4], seen=window.seen[:5])
    sentence = r"^window must hold more than memory = 4 velocities, got 4\.$"
    with pytest.raises(ArgumentError, match=sentence):
        detector().detect(short)


def test_windows_that_show_nothing():
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
def test_the_shortest_windows(steps):
    window, _ = cluster(followers=2)
    short = Window(
        window.position[: steps + 1], window.velocity[:steps], window.seen[: steps + 1], window.alive, window.round
    )
    got = detector(**FEW).detect(short)
    assert got.candidates.sum() == 1
    assert np.isfinite(got.extras["explained"]).all()


@pytest.mark.slow
def test_five_hundred_uavs():
    window, _ = cluster(followers=499)
    got = detector(steps=1).detect(window)
    assert got.attention.shape == (500, 500)
    assert got.candidates.sum() == 1
