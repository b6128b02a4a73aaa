"""The prior draws every family with a truth that fits the motion."""

import numpy as np
import pytest

from detectors.reader.examples import Examples
from detectors.reader.prior import FAMILIES, draw_examples
from detectors.reader.prior.families import FAULTS, MODELS, WORLDS

NOBODY_LEADS = ("shepherd", "reference", "independent", "shifted", "none", "herd", "driver", "leaderless", "walkers")
NOBODY_LEADS += ("ring_road", "route", "springs_unseen")


def draw(family: str | None, seed: int = 0, windows: int = 2, **options) -> Examples:
    return draw_examples(np.random.default_rng(seed), windows, family=family, **options)


@pytest.fixture(scope="module")
def drawn() -> dict[str, Examples]:
    return {family: draw(family, seed=3, most_uavs=24) for family in FAMILIES}


def test_the_families_are_the_models_faults_worlds_and_the_field():
    assert set(FAMILIES) == {*MODELS, *FAULTS, *WORLDS, "field"}
    assert not {"f1", "f2", "f3", "f4", "f5", "f6", "f7"} & set(FAMILIES)


@pytest.mark.parametrize("family", FAMILIES)
def test_shapes_and_truth_fit_together(drawn, family):
    examples = drawn[family]
    windows, instants, uavs, _ = examples.position.shape
    assert (windows, examples.family) == (2, family)
    assert uavs <= 24
    assert examples.velocity.shape == (windows, instants - 1, uavs, 3)
    assert examples.seen.shape == (windows, instants, uavs)
    assert np.isfinite(examples.position).all()
    assert np.isfinite(examples.velocity).all()
    assert not examples.position[~examples.seen].any()
    own = np.arange(uavs)
    for b in range(windows):
        head, leader, root, delay = examples.head[b], examples.leader[b], examples.root[b], examples.delay[b]
        assert (root[root] == root).all()
        assert (root[leader] == root).all()
        assert (leader[head] == own[head]).all()
        assert head[root[leader != own]].all()
        assert np.isnan(delay[leader == own]).all()


@pytest.mark.parametrize("family", [name for name in FAMILIES if name not in (*FAULTS, "informed", "field")])
def test_heads_have_followers_and_swarms_without_a_leader_have_no_head(drawn, family):
    examples = drawn[family]
    follows = examples.leader != np.arange(examples.leader.shape[1])
    for head, root, led in zip(examples.head, examples.root, follows, strict=True):
        assert set(np.flatnonzero(head)) == set(root[led])
        assert head.any() == (family not in NOBODY_LEADS)


@pytest.mark.parametrize("family", ["field", "fault:mix", "random", "people"])
def test_equal_seeds_draw_equal_windows(family):
    first, again, other = (draw(family, seed) for seed in (5, 5, 6))
    for one, two in zip(first, again, strict=True):
        np.testing.assert_array_equal(one, two)
    assert first.position.shape != other.position.shape or (first.position != other.position).any()


def test_families_that_are_left_out_are_not_drawn():
    left = ("star", "walkers", "none")
    without = [family for family in FAMILIES if family not in left]
    assert {draw(None, seed, 1, without=without).family for seed in range(40)} == set(left)


def test_faults_that_are_left_out_are_in_no_field_swarm():
    without = [name for name in FAULTS if name in ("fault:missed", "fault:bursts", "fault:partial", "fault:jumps")]
    for seed in range(8):
        assert draw("field", seed, 1, without=without).seen.all()
        assert draw("path", seed, 1, without=without).seen.all()


@pytest.mark.parametrize(("family", "least"), [("star", 0.4), ("path", 0.6), ("set_off", 0.8), ("unequal_delays", 0.5)])
def test_followers_repeat_their_leader_after_the_delay_and_not_before(family, least):
    late, early = [], []
    for seed in range(12):
        examples = draw(family, seed, without=tuple(FAULTS))  # noise hides the likeness of straight flights
        for b, i in np.argwhere(np.isfinite(examples.delay)):
            lag, leader = round(float(examples.delay[b, i])), examples.leader[b, i]
            led, own = examples.velocity[b, :, leader], examples.velocity[b, :, i]
            if 0 < lag < len(own) // 2 and examples.seen.all():
                late.append(correlate(led[:-lag], own[lag:]))
                early.append(correlate(led[lag:], own[:-lag]))
    assert np.median(late) > least
    assert np.mean(np.array(late) > np.array(early)) > 0.8


def correlate(one: np.ndarray, two: np.ndarray) -> float:
    one, two = one - one.mean(axis=0), two - two.mean(axis=0)
    return float((one * two).sum() / np.sqrt((one**2).sum() * (two**2).sum() + 1e-12))


def test_cars_on_a_ring_stay_on_it():
    ring = draw("ring_road", 1)
    radius = np.linalg.norm(ring.position[..., :2], axis=-1)
    assert radius.std() < 0.1 * radius.mean()


def test_the_largest_swarms_have_as_many_uavs_as_are_asked_for():
    sizes = [draw(None, seed, 1, most_uavs=20).position.shape[2] for seed in range(25)]
    assert max(sizes) <= 20
