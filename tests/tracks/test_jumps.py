"""Wrong fixes: single ones are left out, others are reported, and none of them chooses the step."""

import numpy as np
import pytest
from track_files import tracks_of, write_csv

from usnet_env.tracks import read_tracks

HEADER = ["timestamp", "location-long", "location-lat", "individual-local-identifier", "visible"]
QUICK = ("--detector", "directional-delays")


def pigeons(steps=300, ids=4):
    """Rows of a Movebank file: the others fly as the first did 2 s ago."""
    rng = np.random.default_rng(5)
    rate = np.convolve(rng.normal(0, 0.4, steps), np.ones(6) / 3, "same")
    flown = 12 * np.stack([np.cos(np.cumsum(rate)), np.sin(np.cumsum(rate))], axis=1)
    rows = []
    for k in range(ids):
        velocity = np.roll(flown, 2 * min(k, 1), axis=0) + rng.normal(0, 0.3, flown.shape)
        lon, lat = (np.cumsum(velocity, axis=0) + 20 * k).T / 111_000
        for t in range(steps):
            stamp = f"2010-07-08 09:{12 + t // 60:02}:{t % 60:02}.000"
            rows.append([stamp, 19.04 + float(lon[t]), 47.5 + float(lat[t]), f"bird-{k}", "true"])
    return rows


@pytest.mark.parametrize(("count", "words"), [(1, "1 spike"), (4, "4 spikes")])
def test_fixes_at_zero_degrees_are_left_out_and_change_nothing_else(run, tmp_path, count, words):
    rows = pigeons()
    whole = read_tracks(write_csv(tmp_path / "whole.csv", rows, HEADER))
    for row in rows[8 : 8 + count]:
        row[1:3] = [0.0, 0.0]
    glitch = read_tracks(write_csv(tmp_path / "glitch.csv", rows, HEADER))
    (found,) = glitch.report().warnings
    assert found.startswith(f"{words}, ")
    assert "at 2010-07-08T09:12:08Z (id bird-0)" in found
    even, without = whole.resample(), glitch.resample()
    assert without.step == even.step
    assert glitch.resample(1.0).samples == whole.resample(1.0).samples - count
    there = {(int(owner), round(float(t), 6)): p for owner, t, p in samples_of(even)}
    for owner, t, place in samples_of(without):
        np.testing.assert_allclose(place, there[int(owner), round(float(t), 6)], atol=1.0)  # metres
    for options in ((), ("--keep-spikes", "--step", "1")):
        status, out, err = run("detect", tmp_path / "glitch.csv", *QUICK, *options)
        assert status == 0
        assert f"{words}, " in err
        assert (f"{words} left out, unless keep_spikes (--keep-spikes) is given." in out) == (not options)
        assert "bird-0" in out
    assert np.abs(glitch.resample(1.0, keep_spikes=True).position).max() > 1e6


def samples_of(tracks):
    owner = np.repeat(np.arange(len(tracks.ids)), np.diff(tracks.offsets))
    place = tracks.position - tracks.position[tracks.offsets[1]]  # the frames' middles differ
    return zip(owner, tracks.time, place, strict=True)


@pytest.mark.parametrize(("begin", "end", "moved"), [(0, 40, True), (100, 200, False), (250, 300, True)])
def test_a_part_at_another_place_is_left_out_or_goes_on(begin, end, moved):
    """A part that stands still at an end is no track; one in between is left out, as the track comes back."""
    rng = np.random.default_rng(3)
    walks = np.cumsum(rng.normal(0, 1, (300, 2, 2)) + 1, axis=0)
    walks[begin:end, 0] = -1e5
    even = tracks_of(walks).resample(1.0)
    assert even.samples == 600 - (end - begin)
    assert moved or np.abs(np.diff(even.position[:200], axis=0)).max() < 150


def test_many_single_jumps_of_both_ids_are_left_out():
    walks = np.cumsum(np.random.default_rng(6).normal(0, 1, (300, 2, 2)) + 1, axis=0)
    walks[[40, 90, 130, 210]] += 1e4
    even = tracks_of(walks).resample(1.0)
    assert even.samples == 600 - 8
    assert np.linalg.norm(np.diff(even.position[:296, :2], axis=0), axis=1).max() < 20


def test_a_jump_that_stays_is_closed_and_repeated_fixes_are_left_out():
    walks = np.cumsum(np.random.default_rng(4).normal(0, 1, (300, 2, 2)) + 1, axis=0)
    expected = np.diff(walks[:, 0], axis=0)
    walks[150:, 0] += 7000
    walks[40:60, 1] = walks[40, 1]
    tracks = tracks_of(walks)
    even = tracks.resample(1.0)
    assert "1 jump closed: the track goes on from where it was before." in even.notes
    flown = np.diff(even.position[:300, :2], axis=0)
    np.testing.assert_allclose(np.delete(flown, 149, axis=0), np.delete(expected, 149, axis=0), atol=1e-9)
    assert (even.samples, tracks.resample(1.0, keep_spikes=True).samples) == (581, 600)
    walks[150:, 0] -= 6970  # ten times as fast as usual may have been flown
    assert not any("closed" in note for note in tracks_of(walks).resample(1.0).notes)


def test_heights_whose_grain_hides_the_movement_are_left_out():
    rng = np.random.default_rng(5)
    walks = np.cumsum(rng.normal(0, 1, (200, 2, 3)) + 1, axis=0)
    rough = walks * (1, 1, 0) + rng.integers(0, 5, (200, 2, 1)) * (0, 0, 25)
    for places, dimensions in ((walks, 3), (rough, 2)):
        even = tracks_of(places).resample()
        assert even.dimensions == dimensions
