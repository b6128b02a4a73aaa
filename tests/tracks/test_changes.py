"""When leaders change: dates, and who leads when, with a detector that knows the leaders, but is unsure at times."""

from dataclasses import replace

import numpy as np
import pytest
from track_files import tracks_of

from usnet_env import Detection
from usnet_env.tracks import Period, find_leaders

STEPS, FREE = 240, -1


class Knows:
    """Gives the leaders that ``says`` gives for the middle of each short window, and of the whole file."""

    def __init__(self, says):
        self.says, self.number = says, -1

    def reset(self, seed=None):
        self.number += 1

    def detect(self, window):
        middle = STEPS // 2 if window.observation_steps > 40 else 5 * (self.number - 1) + 20
        leader = np.array(self.says(middle))[: window.uavs]
        leader = np.where(leader == FREE, np.arange(window.uavs), leader)
        others = leader[leader != np.arange(window.uavs)]
        leads = np.isin(np.arange(window.uavs), others) & (leader == np.arange(window.uavs))
        return Detection(leads, leads * 1.0, leader=leader, extras={"probability": leads * 1.0})


def lead(plan, seed=0, noise=0.15, seen=None):
    """Tracks of ids that copy the leader ``plan(t)`` gives for each, 2 steps later, or go on freely."""
    rng = np.random.default_rng(seed)
    ids = len(plan(0))
    heading = np.cumsum(rng.normal(0, 0.3, (STEPS, ids)), axis=0)
    free = np.stack([np.cos(heading), np.sin(heading)], axis=2)
    velocity = rng.normal(0, noise, (STEPS, ids, 2))
    for t in range(STEPS):
        for i, leader in enumerate(plan(t)):
            velocity[t, i] = free[t, i] if leader == FREE else velocity[t, i] + velocity[max(0, t - 2), leader]
    place = 20 * rng.normal(size=(ids, 2)) + np.cumsum(velocity, axis=0)
    return tracks_of(place, names=range(ids), seen=seen).resample(1.0)


def find(plan, says=None, seen=None, *, confirm=False):
    return find_leaders(lead(plan, seen=seen), Knows(says or plan), length=STEPS - 1, confirm=confirm)


@pytest.mark.parametrize("kind", ["merges", "splits"])
def test_a_group_that_keeps_its_leader_is_dated_by_the_motion_of_that_leader(kind):
    """Id 4 leads 5 to 7 all the time, and follows id 0 from 120 on, or until then."""

    def plan(t):
        return [FREE, 0, 0, 0, 0 if (t >= 120) == (kind == "merges") else FREE, 4, 4, 4]

    *_, change = find(plan, lambda t: [0] * 8 if plan(t)[4] == 0 else plan(t)).events
    assert (change.kind, change.ids) == (kind, (5, 6, 7))
    assert change.low <= 119 <= change.high <= change.low + 8


def test_ids_that_cease_to_follow_at_once_have_one_date():
    """The detector sees it earlier or later for each."""

    def says(t):
        return [FREE, *(0 if t < end else FREE for end in (60, 80, 100, 110, 118))]

    start, end = find(lambda t: [FREE, *[0 if t < 110 else FREE] * 5], says).events
    assert (start.time, end.ids) == (0, (1, 2, 3, 4, 5))
    assert end.low <= 109 <= end.high <= end.low + 4


def test_ids_follow_on_where_the_detector_is_unsure():
    """Nor is it an event that an id is seen one step after the others."""
    seen = np.ones((STEPS, 5), bool)
    seen[0, 3] = False
    found = find(lambda t: [FREE, 0, 0, 1, 1], lambda t: [FREE] * 5 if 100 < t < 160 else [FREE, 0, 0, 1, 1], seen)
    (start,) = found.events
    assert (start.time, start.kind) == (0, "leads")


def test_a_leader_that_no_window_names_is_one_only_if_its_past_explains_the_motion():
    """Id 1 is said to follow id 3 up to 70; all follow id 0 from 110 on."""

    def says(t):
        return [FREE, 3 if t < 70 else FREE, FREE, FREE] if t < 110 else [FREE, 0, 0, 0]

    found = find(lambda t: [FREE, *[0 if t >= 110 else FREE] * 3], says, confirm=True).events
    assert {event.new for event in found} == {0}
    assert found[-1].low <= 109 <= found[-1].high
    assert 1 in found[-1].ids


@pytest.mark.parametrize(("uav", "first", "last"), [(0, 80, 239), (0, 0, 150), (3, 70, 239), (3, 20, 160)])
def test_an_id_leads_and_follows_only_while_it_has_a_track(uav, first, last):
    seen = np.ones((STEPS, 5), bool)
    seen[:first, uav] = seen[last + 1 :, uav] = False

    def says(t):
        return [FREE] * 5 if uav == 0 and not first <= t <= last else [FREE, 0, 0, 0, 0]

    found = find(lambda t: [FREE, 0, 0, 0, 0], says, seen)
    led = [each for each in found.periods if each.leader == 0 and uav in each.rows]
    spans = [(each.start, each.low, each.high, each.end) for each in led]
    assert spans
    assert first <= np.min(spans) <= first + 4
    assert last >= np.max(spans)
    assert {event.time for event in found.events} <= {0, last, *range(first, first + 4)}


def test_a_leader_in_no_group_has_a_row_in_the_timeline():
    found = find(lambda t: [FREE, 0, 0])
    (axes,) = replace(found, periods=(Period((1, 2), 0, 0.0, 120.0, 0.0, 0.0, 1.0),)).plot_timeline().axes
    assert {round(bar.get_y() + 0.4) for bar in axes.patches if bar.get_width() > 0} == {0, 1, 2}
