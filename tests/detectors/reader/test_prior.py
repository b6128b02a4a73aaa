"""The prior draws every family with a truth that fits the motion."""

import numpy as np
import pytest

from detectors.reader.examples import Examples
from detectors.reader.prior import FAMILIES, draw_examples
from detectors.reader.prior.families import FAULTS, LAWS, MODELS, WORLDS
from detectors.reader.prior.observing import observe
from detectors.reader.prior.random_laws import draw_law
from usnet_env.swarm import kernels
from usnet_env.swarm.strategy import TrajectoryBatch

NOBODY_LEADS = ("shepherd", "reference", "independent", "shifted", "none", "herd", "driver", "leaderless", "walkers")
NOBODY_LEADS += ("ring_road", "route", "springs_unseen", "strangers", "unled", "driven")


def draw(family: str | None, seed: int = 0, windows: int = 2, **options) -> Examples:
    return draw_examples(np.random.default_rng(seed), windows, family=family, **options)


@pytest.fixture(scope="module")
def drawn() -> dict[str, Examples]:
    return {family: draw(family, seed=3, most_uavs=24) for family in FAMILIES}


def test_the_families_are_the_models_faults_worlds_and_the_field():
    assert set(FAMILIES) == {*MODELS, *LAWS, *FAULTS, *WORLDS, "field"}
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
        link = examples.link[b]
        assert np.isnan(link).all() or ((link[own, leader] == 1) | (leader == own)).all()
        assert not np.diagonal(link)[np.isfinite(np.diagonal(link))].any()


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


def test_families_and_faults_that_are_left_out_are_not_drawn():
    left = ("star", "walkers", "none")
    without = [family for family in FAMILIES if family not in left]
    assert {draw(None, seed, 1, without=without).family for seed in range(40)} == set(left)
    without = [name for name in FAULTS if name in ("fault:missed", "fault:bursts", "fault:partial", "fault:jumps")]
    for seed in range(8):
        assert draw("field", seed, 1, without=without).seen.all()
        assert draw("path", seed, 1, without=without).seen.all()


REPEATED = {"star": 0.4, "path": 0.6, "set_off": 0.8, "unequal_delays": 0.5, "factions": 0.6, "turn_rate": 0.5}


@pytest.mark.parametrize(("family", "least"), REPEATED.items())
def test_followers_repeat_their_leader_after_the_delay_and_not_before(family, least):
    late, early = [], []
    for seed in range(12):
        examples = draw(family, seed, without=tuple(FAULTS))  # noise hides the likeness of straight flights
        motion = find_turns(examples.velocity) if family == "turn_rate" else examples.velocity
        for b, i in np.argwhere(np.isfinite(examples.delay)):
            lag, leader = round(float(examples.delay[b, i])), examples.leader[b, i]
            led, own = motion[b, :, leader], motion[b, :, i]
            if 0 < lag < len(own) // 2 and examples.seen.all():
                late.append(correlate(led[:-lag], own[lag:]))
                early.append(correlate(led[lag:], own[:-lag]))
    assert np.median(late) > least
    assert np.mean(np.array(late) > np.array(early)) > 0.8


def find_turns(velocity: np.ndarray) -> np.ndarray:
    """Changes of the course on the plane ``(B, T - 1, n)``, radians."""
    course = np.unwrap(np.arctan2(velocity[..., 1], velocity[..., 0]), axis=1)
    return np.diff(course.astype(float), axis=1)


@pytest.mark.parametrize("family", ["formation", "factions"])
def test_a_leader_is_in_front_and_its_own_motion_tells_nothing_in_a_formation(family):
    front, first = [], []
    for seed in range(40):
        examples = draw(family, seed, without=tuple(FAULTS), most_uavs=12)
        for b, i in np.argwhere(examples.leader != np.arange(examples.leader.shape[1])):
            pair = [examples.leader[b, i], i]
            place, motion = examples.position[b][:, pair].mean(axis=0), examples.velocity[b][:, pair]
            front.append(np.subtract(*(place @ motion.mean(axis=(0, 1)))) > 0)
            first.append(sum_lead(motion[:, 0], motion[:, 1]) > 0)
    assert np.mean(front) > 0.75
    assert (np.mean(first) > 0.7) == (family == "factions")  # who begins and turns first


def sum_lead(one: np.ndarray, two: np.ndarray) -> float:
    """How much better ``two`` repeats ``one`` than the other way around, each at the best of the delays."""
    lags = range(1, min(12, len(one) // 3))
    late, early = ([correlate(a[:-lag], b[lag:]) for lag in lags] for a, b in ((one, two), (two, one)))
    return max(late) - max(early)


def correlate(one: np.ndarray, two: np.ndarray) -> float:
    one, two = one - one.mean(axis=0), two - two.mean(axis=0)
    return float((one * two).sum() / np.sqrt((one**2).sum() * (two**2).sum() + 1e-12))


def fly_law(law, velocity_of_head, uavs=4, steps=40):
    """Velocities ``(S, n, 3)`` of the followers of UAV 0."""
    rng, past = np.random.default_rng(0), law.lags
    velocity = rng.standard_normal((1, past + steps, uavs, 3), dtype=np.float32)
    velocity /= np.linalg.norm(velocity, axis=-1, keepdims=True)
    velocity[0, past:, 0] = velocity_of_head
    place = 10 * rng.standard_normal((1, 1, uavs, 3), dtype=np.float32)
    position = np.concatenate([place, place + np.cumsum(velocity, axis=1)], axis=1)
    motion = np.full((1, uavs), kernels.FOLLOWS, np.int8)
    motion[0, 0] = kernels.FREE
    head = np.zeros((1, uavs), np.int64)
    numbers = head, rng.random((1, uavs), dtype=np.float32), head, np.zeros((1, uavs), bool), np.zeros(1, np.int64)
    noise = rng.standard_normal((1, steps, uavs, 3), dtype=np.float32)
    law.fly(TrajectoryBatch(position, velocity, noise, motion, *numbers))
    return velocity[0, past:, 1:]


@pytest.mark.parametrize("seed", range(12))
def test_a_random_law_answers_its_head_when_it_has_heard_it_and_not_before(seed):
    law = draw_law(np.random.default_rng(seed), 100)
    rng = np.random.default_rng(99)
    course = rng.standard_normal((40, 3))
    other = np.concatenate([course[:10], rng.standard_normal((30, 3))])
    one, two = (fly_law(law, x / np.linalg.norm(x, axis=1, keepdims=True)) for x in (course, other))
    first = 10 + int(law.find_delays(np.zeros(1))[0])  # the way to the head is known at once
    reach = first if not law.inner[9:12].any() else 11
    np.testing.assert_array_equal(one[:reach], two[:reach])
    assert np.abs(one - two).max() > 0.01 or first >= 40


def test_trees_of_a_random_law_have_relays_with_their_delays():
    found = [draw("random_law", seed, 1) for seed in range(12)]
    assert any((each.leader != each.root).any() for each in found)
    for each in found:
        late = each.delay[each.leader != np.arange(each.head.shape[1])]
        assert (late >= 0.5).all() or np.isnan(late).all()


def test_in_a_driven_herd_those_behind_turn_first():
    first = []
    for seed in range(120):
        herd = draw("driven", seed, 1, without=tuple(FAULTS))
        order = (herd.position[0].mean(axis=0) @ herd.velocity[0].mean(axis=(0, 1))).argsort()
        rear, front = (herd.velocity[0][:, part].mean(axis=1) for part in (order[1:4], order[-3:]))
        if rear.std(axis=0).max() > 0.4 * np.linalg.norm(rear.mean(axis=0)):  # those that turn much
            first.append(sum_lead(rear, front) > 0)
    assert np.mean(first) > 0.65


def test_some_ids_are_in_view_for_a_part_of_a_window():
    whole = draw("strangers", 1, windows=8, without=tuple(FAULTS))
    seen = observe(whole, np.random.default_rng(0), (), "fault:partial").seen
    assert whole.seen.all()
    assert 0.05 < seen.mean(axis=1).min() < 0.5 < seen.mean() < seen.mean(axis=1).max() == 1.0
    assert (np.abs(np.diff(seen.astype(int), axis=1)).sum(axis=1) <= 2).all()  # none comes back
