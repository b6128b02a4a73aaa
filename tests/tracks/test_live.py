"""Leaders while fixes come: the answers of ``find_leaders``, announced when they are sure."""

from types import SimpleNamespace

import numpy as np
import pytest
from track_files import tracks_of

from usnet_env import ArgumentError, Detection
from usnet_env.tracks import LeaderTracker, find_leaders

CHANGE = 34  # seconds at which another one leads


def fly(seed, seconds=60, uavs=6, heads=(0, 4)):
    """Positions ``(T, N, 2)`` at 1 Hz; all copy the first of the heads after 1 to 3 s, and from CHANGE on the second.

    Without heads, they copy a velocity that none of them has.
    """
    rng = np.random.default_rng(seed)
    turns = np.cumsum(rng.normal(0, 0.5, (seconds, uavs + 1)), axis=0)
    own = 4 * np.stack([np.cos(turns), np.sin(turns)], axis=2)
    velocity = rng.normal(0, 0.3, (seconds, uavs, 2))
    for t in range(seconds):
        head = heads[t >= CHANGE] if heads else -1
        for k in range(uavs):
            source, lag = (velocity, 1 + k % 3) if heads else (own, 0)
            velocity[t, k] = own[t, k] if k == head else velocity[t, k] + source[max(t - lag, 0), head]
    return 20 * rng.normal(size=(uavs, 2)) + np.cumsum(velocity, axis=0)


def watch(tracker, place, ids):
    return [tracker.update(t, now, ids) for t, now in enumerate(place)]


def sentences(known):
    return [str(change).partition(": ")[2] for each in known for change in each.changes]


def test_a_leader_and_the_one_that_takes_over_are_announced_once():
    place, tracker = fly(3), LeaderTracker(step=1.0, stride=2)
    known = watch(tracker, place, [*"abcdef"])
    assert sentences(known) == ["a leads b, c, d, e, f.", "e leads b, c, d, f instead of a."]
    (first, then) = (k for k, each in enumerate(known) if each.changes)
    assert first < 24
    assert CHANGE < then <= CHANGE + 15
    assert not any(each.sure or each.leaders for each in known[:first])
    assert known[-1].sure
    assert known[-1].leaders["e"] > 0.9
    assert known[-1].follows == dict.fromkeys("abcdf", "e")


class Doubts:
    """In ten whole windows the first id leads, later it may; in shorter ones the fifth does."""

    def __init__(self):
        self.whole_windows = 0

    def reset(self, seed=None):
        pass

    def detect(self, window):
        is_whole = window.observation_steps == 16
        self.whole_windows += is_whole
        head, p = (4, 0.95) if not is_whole else (0, 1.0 if self.whole_windows <= 10 else 0.5)
        chance = np.where(np.arange(window.uavs) == head, p, 0.0)
        return Detection(chance > 0.5, chance, leader=np.full(window.uavs, head), extras={"probability": chance})


def test_the_latest_part_of_a_window_is_asked_only_if_the_whole_doubts_an_announced_leader():
    tracker, place = LeaderTracker(step=1.0, detector=Doubts()), fly(3)
    known = watch(tracker, place, [*range(6)])
    assert sentences(known) == ["0 leads 1, 2, 3, 4, 5.", "4 leads 1, 2, 3, 5 instead of 0."]
    first, then = (k for k, each in enumerate(known) if each.changes)
    assert then - first == 8  # five more sure answers, then three of the latest part
    doubting = Doubts()
    doubting.whole_windows = 10
    assert sentences(watch(LeaderTracker(step=1.0, detector=doubting), fly(3, heads=(4, 4)), [*range(6)])) == []


def test_a_window_has_the_heads_of_find_leaders():
    place, heads, same = fly(3), [], []
    for until in (24, 36, 44, 58):
        part, tracker = place[:until], LeaderTracker(step=1.0, window=20)
        tracker.update(np.repeat(np.arange(float(until)), 6), part.reshape(-1, 2), [*range(6)] * until)
        same.append([tracker.track_window.ids[k] for k in np.flatnonzero(tracker.detection.candidates)])
        tracks = tracks_of(place[until - 21 : until], names=range(6))
        (window,) = find_leaders(tracks, step=1.0, window=20, confirm=False).windows
        heads.append([leader.id for leader in window.leaders])
    assert heads == same
    assert [0] in heads
    assert [4] in heads


def test_fixes_may_be_late_and_missing_and_ids_come_and_go():
    place, rng = fly(3), np.random.default_rng(0)
    fixes = [(t + rng.choice([0, 0, 0, 1.5]), t, k) for t in range(60) for k in range(6) if rng.random() > 0.1]
    fixes = [fix for fix in fixes if not (fix[2] == 5 and fix[1] > 20) and not (fix[2] == 3 and fix[1] < 12)]
    tracker, known = LeaderTracker(step=1.0, stride=2), []
    for _, t, k in sorted(fixes):
        known.append(tracker.update(t, place[t, [k]], ["abcdef"[k]]))
    changes = [change for each in known for change in each.changes]
    assert [change.new for change in changes if change.kind in ("leads", "takes over")] == [*"ae"]
    assert known[-1].follows == dict.fromkeys("abcd", "e")
    assert tracker.update(60, [[np.nan, np.nan]], ["a"]).leaders == known[-1].leaders


def test_it_is_known_in_the_end_that_nobody_leads():
    known = watch(LeaderTracker(step=1.0, stride=2), fly(0, heads=()), range(6))
    assert sentences(known) == []
    assert [each.sure for each in known[:: len(known) - 1]] == [False, True]


@pytest.mark.parametrize(
    ("update", "sentence"),
    [
        ((0, [[1, 2]], ["a", "b"]), r"^positions must have shape \(2, 2 or 3\) for the ids, got \(1, 2\)"),
        ((np.nan, [[1, 2]], ["a"]), r"^t must hold finite numbers"),
        ((0, [[1, 2]], [1.5]), r"^ids must hold texts or whole numbers, got \[1.5\]"),
    ],
)
def test_wrong_fixes_are_refused(update, sentence):
    with pytest.raises(ArgumentError, match=sentence):
        LeaderTracker(step=1.0).update(*update)
    with pytest.raises(ArgumentError, match=r"^window must be .* 16"):
        LeaderTracker(step=1.0, window=8)


class Pieces:
    """A stream that gives a text in pieces of some bytes."""

    def __init__(self, text, size):
        self.parts = [text[k : k + size].encode() for k in range(0, len(text), size)]

    def read1(self, most):
        return self.parts.pop(0) if self.parts else b""


def test_the_command_prints_a_line_at_each_change(run, monkeypatch):
    place, day = fly(3), np.datetime64("2024-05-01T12:00:00")
    rows = [f"{'abcdef'[k]};{day + t};{x};{y}" for t, now in enumerate(place * 100) for k, (x, y) in enumerate(now)]
    text = "\n".join(["# fixes", "animal;timestamp;x (cm);y (cm)", *rows, ""])
    monkeypatch.setattr("sys.stdin", SimpleNamespace(buffer=Pieces(text, 700)))
    status, out, err = run("detect", "-", "--follow", "--step", 1, "--stride", 2, "--column", "id=animal")
    assert (status, err) == (0, "")
    first, then = out.splitlines()
    assert first.startswith("From 2024-05-01T12:00:")
    assert first.endswith("Z: a leads b, c, d, e, f.")
    assert then.endswith("Z: e leads b, c, d, f instead of a.")
    assert run("detect", "-", "--follow")[0] == 2
