"""Tracks that misled: the leader is found, or the reason is said why none is, but no follower is called a leader."""

import numpy as np
import pytest

from usnet_env.tracks import Tracks, find_leaders


def follow(steps, delays, *, seed=0, gain=1.0):
    """Positions ``(T, 1 + n, 2)`` of a leader, the first, and of n ids that copy its velocity so many steps later."""
    rng = np.random.default_rng(seed)
    drawn = rng.normal(0, 1, (steps + max(delays) + 12, 2))
    velocity = np.apply_along_axis(np.convolve, 0, drawn, np.ones(12) / 12**0.5, "valid")[: steps + max(delays)]
    late = [velocity[max(delays) - lag :][:steps] for lag in (0, *delays)]
    moved = np.stack([late[0], *(gain * each + rng.normal(0, 0.25, each.shape) for each in late[1:])], axis=1)
    return np.cumsum(moved, axis=0) + rng.normal(0, 5, (1, len(late), 2)) + rng.normal(0, 0.05, moved.shape)


def tracks_of(position, seen=None, time=None):
    steps, ids = position.shape[:2]
    time = np.arange(float(steps)) if time is None else time
    kept = np.ones((steps, ids), bool) if seen is None else seen
    at, of = np.nonzero(kept)
    return Tracks.from_samples([f"a{k}" for k in of], time[at], position[at, of])


def names(found):
    return {leader.id for leader in found.leaders}


def test_a_leader_whose_place_is_repeated_is_no_follower():
    position = follow(900, [3, 5, 6, 8, 4])
    position[:, 0] = position[np.arange(900) // 6 * 6, 0]
    found = find_leaders(tracks_of(position))
    assert names(found) == {"a0"}
    assert any("repetitions of places left out: those of a0" in fact for fact in found.facts)


@pytest.mark.parametrize("rests", [True, False])
def test_pauses_are_skipped_and_times_are_those_of_the_file(rests):
    bout, every, bouts = 60, 600, 6
    moving = follow(bout * bouts, [2, 3, 4, 5, 6])
    at = np.concatenate([np.arange(bout) + every * k for k in range(bouts)])
    whole = np.repeat(np.arange(bout * bouts), np.diff(np.append(at, every * bouts)))
    still = np.random.default_rng(1).normal(0, 0.02, (len(whole), *moving.shape[1:]))
    tracks = tracks_of(moving[whole] + still) if rests else tracks_of(moving, time=at.astype(float))
    found = find_leaders(tracks)
    assert names(found) == {"a0"}
    assert any("pauses skipped" in fact for fact in found.facts)
    assert every * (bouts - 1) < found.windows[-1].end <= every * bouts


def test_long_delays_choose_a_longer_step():
    found = find_leaders(tracks_of(follow(900, [15, 18, 20, 22, 25])))
    assert names(found) <= {"a0"}
    assert found.track_windows[0].step >= 4
    assert not any("clock" in fact for fact in found.facts)


def test_a_late_clock_is_named():
    position = follow(400, [2, 4, 5, 6, 3])
    late = np.stack([np.roll(position[:, 0], 9, axis=0), *position.swapaxes(0, 1)[1:]], axis=1)[10:]
    found = find_leaders(tracks_of(late), "lagged-correlation")
    assert any("a0 comes" in fact and "if its clock is late, it leads" in fact for fact in found.facts)


def test_followers_that_mirror_their_leader_are_no_proof_that_none_leads():
    text = str(find_leaders(tracks_of(follow(300, [2, 3, 4, 5], gain=np.array([-1.0, 1.0])))))
    assert "nobody" not in text
    assert "No leader was found." in text
    assert "The nearest candidate is" in text


def test_a_window_is_read_in_halves_where_its_leader_changes():
    first, second = follow(150, [2, 3, 3, 4, 2]), follow(150, [2, 3, 3, 4, 2], seed=1)
    order = [1, 0, 2, 3, 4, 5]
    position = np.concatenate([first, first[-1] + second[:, order] - second[0, order]])
    found = find_leaders(tracks_of(position))
    assert names(found) == {"a0", "a1"}
