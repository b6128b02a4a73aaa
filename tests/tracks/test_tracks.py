"""Tracks: resampling, windows, and what is reported."""

import re
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from track_files import Answers, answer_of, example, straight, tracks_of

from usnet_env import ArgumentError
from usnet_env.tracks import Tracks, find_leaders

dense = partial(tracks_of, step=0.5)


def wandering(steps=400, uavs=6, delay=2, noise=0.0, seed=0):
    """Positions of a leader that turns smoothly and followers that copy its velocity after ``delay`` samples."""
    rng = np.random.default_rng(seed)
    leader = example().wander(rng, steps)
    velocity = np.stack([leader, *(np.roll(leader, delay, axis=0) for _ in range(uavs - 1))], axis=1)
    velocity[:, 1:] += rng.normal(0, 0.4, velocity[:, 1:].shape)
    place = rng.uniform(-50, 50, (uavs, 2)) + np.cumsum(velocity, axis=0) * 0.5
    place += rng.normal(0, noise, place.shape)
    return np.concatenate([place, np.zeros((steps, uavs, 1))], axis=2)


@settings(max_examples=30)
@given(
    st.floats(0.05, 3.0),
    st.integers(0, 2**32),
    st.tuples(*[st.floats(-20, 20)] * 3),
    st.floats(-1e6, 1e6),
    st.booleans(),
)
def test_resampling_of_straight_flight_is_exact(step, seed, velocity, far, even):
    """Whether positions are interpolated or fitted, and however uneven the sampling is."""
    rng = np.random.default_rng(seed)
    times = np.arange(60) * 0.25 if even else np.cumsum(rng.uniform(0.05, 0.4, 60))
    tracks = tracks_of(np.repeat(far + times[:, None, None] * np.array(velocity), 2, axis=1), times=times)
    grid = tracks.resample(step, max_gap=10.0)
    assert grid.samples
    expected = far + (times[0] + grid.time)[:, None] * np.array(velocity) - tracks.origin
    np.testing.assert_allclose(grid.position, expected, atol=1e-7)
    np.testing.assert_allclose(grid.time / step, np.round(grid.time / step), atol=1e-6)


@settings(max_examples=20)
@given(st.tuples(*[st.floats(-1e7, 1e7)] * 3), st.integers(0, 100))
def test_shifting_the_origin_changes_nothing(shift, seed):
    """Also at the size of UTM coordinates, where float32 has a grain of half a metre: millimetres are kept."""
    places = wandering(seed=seed)
    here, there = (dense(each).resample(0.5) for each in (places, places + np.array(shift)))
    for one, other in zip(here.windows(50), there.windows(50), strict=True):
        np.testing.assert_allclose(one.window.velocity, other.window.velocity, atol=1e-6)
        np.testing.assert_allclose(one.window.position, other.window.position, atol=1e-3)
        assert (one.ids, one.start, one.end) == (other.ids, other.start, other.end)


def test_windows_hold_positions_velocities_masks_ids_and_times():
    places = wandering(steps=101)
    keep = np.ones((101, 6), bool)
    keep[40:50, 2] = False
    keep[:95, 5] = False
    tracks = dense(places, seen=keep)
    (cut,) = tracks.resample(0.5).windows(100, least_steps=10)
    assert cut.ids == tuple(f"a{i}" for i in range(5))  # the sixth is seen in 5 steps
    window = cut.window
    assert (window.uavs, window.observation_steps, cut.start, cut.end, cut.step) == (5, 100, 0.0, 50.0, 0.5)
    assert window.step == 0.5
    np.testing.assert_array_equal(window.seen, keep[:, :5])
    assert window.position.dtype == np.float32
    assert not window.position[~window.seen].any()
    assert not window.position[..., 2].any()
    place = window.position + cut.origin + tracks.origin
    np.testing.assert_allclose(place[window.seen], places[:, :5][keep[:, :5]], atol=1e-4)
    moved = np.diff(places[:, :5], axis=0)
    np.testing.assert_allclose(window.velocity[window.velocity_seen], moved[window.velocity_seen], atol=1e-5)
    assert not window.velocity[~window.velocity_seen].any()


def test_windows_overlap_by_the_stride_and_leave_out_where_too_few_are_seen():
    keep = np.ones((400, 6), bool)
    keep[100:200, 1:] = False
    even = dense(wandering(), seen=keep).resample(0.5)
    starts = [cut.start for cut in even.windows(50, 25)]
    assert starts == [12.5 * k for k in (0, 1, 2, 7, 8, 9, 10, 11, 12, 13, 13.96)]  # 75 to 174 see one id in most steps
    with pytest.raises(ArgumentError, match=r"^length must be at most 399"):
        even.windows(500)


def test_a_grid_time_has_the_leader_of_the_nearest_sample():
    leaders = ["b", "c", "c", "b", "c"]
    ids, time = ["a"] * 5 + ["b"] * 5 + ["c"] * 5, np.tile(np.arange(5.0), 3)
    tracks = Tracks.from_samples(ids, time, np.arange(30.0).reshape(15, 2), [*leaders, *[""] * 10])
    even = tracks.resample(0.4)
    first = slice(*even.offsets[:2])
    expected = [leaders[round(t)] for t in even.time[first]]
    assert len(expected) == 11
    assert [even.ids[k] for k in even.leader[first]] == expected


@pytest.mark.parametrize("delay", [1, 3, 30])
def test_the_step_puts_the_delay_at_1_to_4_samples(delay):
    tracks = dense(wandering(steps=1500, delay=delay))
    even = tracks.resample()
    assert 1 <= delay * 0.5 / even.step <= 4
    told = float(re.search(r"typical delay (\S+) s", even.notes[-1])[1])
    assert told == pytest.approx(delay * 0.5, abs=even.step / 4)


def test_the_step_is_longer_where_positions_are_noisy():
    """It is the first in which the squared movement exceeds its noise, of two axes at both ends, four times."""
    quiet, noisy = (dense(wandering(steps=1500, noise=noise)).resample() for noise in (0.0, 3.0))
    place = wandering(steps=1500)
    moved = [((place[k:] - place[:-k]) ** 2).sum(axis=2).mean() / (4 * 3.0**2 / k) for k in (3, 4)]
    assert moved[0] < 4 < moved[1]
    assert (quiet.step, noisy.step) == (0.5, 4 * 0.5)
    assert "about 3 m from sample to sample, and shorter delays may be missed" in noisy.notes[0]


def test_a_window_is_cut_alike_at_other_steps():
    """With the same ids and times, at steps that the samples allow; none where the step was given."""
    places = wandering(steps=1500, delay=30)
    keep = np.ones(places.shape[:2], bool)
    keep[700:900, 2] = False
    even = dense(places, seen=keep).resample()
    times = [other.step / even.step for other in even.other_steps]
    assert times == [0.25, 0.5]
    assert [dense(places).resample(step).other_steps for step in (0.5, 4.0)] == [(), ()]
    fine = dense(wandering(steps=400, delay=1)).resample()
    assert (fine.step, fine.other_steps) == (0.5, ())
    for cut in even.windows(80):
        for factor, other in zip(times, even.other_steps, strict=True):
            same = other.cut_like(cut)
            assert same.ids == cut.ids
            assert cut.start <= same.start < same.end <= cut.end
            assert same.window.observation_steps == pytest.approx(80 / factor, abs=1)
            np.testing.assert_allclose(same.origin, cut.origin, atol=2.0)
    assert even.other_steps[0].cut_like(next(even.windows(120))) is None  # of 480 steps


class AnswersByStep(Answers):
    """A detector whose answer is a function of the number of UAVs and the step of the window."""

    def detect(self, window):
        return self.answer(window.uavs, window.step)


@pytest.mark.parametrize("best", [0.25, 0.5, 1.0])
def test_of_the_steps_at_which_somebody_leads_the_usual_answer_counts(best):
    even = dense(wandering(steps=1500, delay=30)).resample()
    steps = [factor * even.step for factor in (best, *{0.25, 0.5, 1.0} - {best})]

    def name_another_at_each(uavs, step):  # somebody leads at the best step only
        rank = steps.index(step)
        return replace(answer_of(uavs, rank), extras={"p_no_leader": 0.7 - 0.6 * (rank == 0)})

    def name_one_more_at_the_best(uavs, step):  # somebody leads at all of them
        named = np.arange(uavs) <= (step == steps[0])
        return replace(answer_of(uavs, 0), candidates=named, extras={"silent": 0.1 if step == steps[0] else 0.2})

    for answer in (name_another_at_each, name_one_more_at_the_best):
        found = find_leaders(even, AnswersByStep(answer), length=80, confirm=False)
        assert [leader.id for leader in found.leaders] == ["a0"]


def test_where_no_id_follows_the_step_is_four_intervals():
    rng = np.random.default_rng(0)
    places = np.cumsum(rng.normal(size=(600, 5, 3)), axis=0)
    even = dense(places).resample()
    assert even.step == 2.0
    assert "no id follows" in even.notes[-1]


def test_gaps_are_masked_and_short_ones_interpolated_on_demand():
    keep = np.ones((400, 6), bool)
    keep[50, 0] = keep[100:110, 1] = False
    tracks = dense(wandering(), seen=keep)
    assert tracks.resample(0.5).samples == 400 * 6 - 11
    assert tracks.resample(0.5, max_gap=1.0).samples == 400 * 6 - 10
    assert tracks.resample(0.5, max_gap=100).samples == 400 * 6


def test_sessions_that_are_years_apart_need_no_memory_for_the_time_between():
    times = np.arange(100) * 0.1
    even = dense(np.tile(wandering(steps=100), (2, 1, 1)), times=np.append(times, 1e8 + times)).resample(0.5)
    assert even.samples == 6 * 40
    assert [even.file_time(cut.start) >= 1e8 for cut in even.windows(10)] == [False, False, False, True, True]


def test_gaps_jumps_and_uneven_sampling_are_reported_and_nothing_of_clean_tracks():
    report = dense(wandering()).report()
    assert report.warnings == ()
    assert "6 ids, 2400 samples from 0.0 to 199.5" in report.facts[0]
    with pytest.raises(ValueError, match="read-only"):
        dense(wandering()).position[0] = 0
    keep = np.ones((400, 6), bool)
    keep[100:110, 1] = False
    (found,) = dense(wandering(), seen=keep).report().warnings
    assert "takes 5.5 s, after 49.5 (id a1)" in found
    keep[:100, 1:] = False
    assert dense(wandering(), seen=keep).report().facts[1] == "1 of 6 ids is present throughout."
    places = wandering()
    places[200:, 3] += (300, 0, 0)
    (found,) = replace(dense(places), frame="pixels").report().warnings
    assert found.startswith("1 jump, ")
    assert found.count(" px/s") == 2
    assert "after 99.5 (id a3)" in found
    times = np.cumsum(np.random.default_rng(0).uniform(0.2, 0.8, 400))
    (found,) = dense(wandering(), times=times).report().warnings
    assert "uneven" in found


RESAMPLING = {"step": (0, "fast", 1e-9, 10), "max_gap": (np.nan,)}
WINDOWS = {"length": (0, 1.5), "stride": (0,), "least_steps": (0,)}


@pytest.mark.parametrize(
    ("name", "value"), [(name, each) for name, values in (RESAMPLING | WINDOWS).items() for each in values]
)
def test_bad_resampling_and_bad_windows_are_refused(name, value):
    tracks = dense(straight())
    cut = tracks.resample if name in RESAMPLING else tracks.resample(0.5).windows
    with pytest.raises(ArgumentError, match=f"^{name} must be"):
        cut(**({"step": 1.0} if name in RESAMPLING else {"length": 10}) | {name: value})


@pytest.mark.parametrize(
    ("name", "arguments"),
    [
        ("ids", (["a"], [0.0, 1.0], [[0, 0], [1, 1]])),
        ("time", (["a", "b"], [0.0], [[0, 0], [1, 1]])),
        ("time", (["a", "a"], [0.0, 0.0], [[0, 0], [1, 1]])),
        ("position", (["a", "b"], [0.0, 1.0], [[0, 0], [1, np.nan]])),
        ("position", (["a", "b"], [0.0, 1.0], [0, 1])),
        ("tracks", (["a", "b"], [0.0, 1.0], [[0, 0], [1, 1]])),
    ],
)
def test_bad_samples_are_refused(name, arguments):
    with pytest.raises(ArgumentError, match=f"^{name} must"):
        Tracks.from_samples(*arguments).resample(1.0)
