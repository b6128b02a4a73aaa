"""The parts of the second grammar, each against a literal reading."""

import numpy as np
import pytest

from usnet_env.swarm.open_follow import MEMORY, Constants
from usnet_env.swarm.second_follow import ANSWERS, SEEN, STEPS, STRENGTH, Sight

LAW = Constants(delay=3, spread=2, gain=0.7, reach=40.0, sharpness=0.5, course=1.0)
PHASE = np.linspace(0, 0.99, 9)[:, None]


def see(azimuth=(0.0,) * STEPS, climb=0.0, ahead=(1.0, 0.0, 0.0), clock=0):
    """What 9 followers that fly along x see of a head that flies these courses, newest first."""
    level = np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros(STEPS)], axis=1)
    course = np.cos(climb) * level + [0.0, 0.0, np.sin(climb)]
    course, bearing = (np.tile(each, (9, 1, 1)) for each in (course, np.broadcast_to(ahead, (STEPS, 3))))
    return Sight(np.tile([1.0, 0.0, 0.0], (9, 1)), course, bearing, PHASE, clock)


def test_a_head_is_seen_at_looks_late_or_in_a_mirror():
    now = np.arange(200)
    glimpses, drifting, mirrored = (np.array([look(LAW, PHASE, t)[0] for t in now]) for look in SEEN.values())
    for lag in (glimpses, drifting, mirrored):
        assert (lag >= np.arange(STEPS)).all()
        assert lag.max() < MEMORY
    instants = [np.unique((now[20:, None] - lag).ravel()) for lag in glimpses[20:].swapaxes(0, 1)]
    assert all((np.diff(each) == 4).all() for each in instants)  # 2 + spread
    assert (drifting[..., 0].min(axis=0) == 0).all()
    assert (drifting[..., 0].max(axis=0) == 5).all()
    assert (mirrored == 3 + np.arange(STEPS)).all()
    mirror = SEEN["in a mirror"](LAW, PHASE, 0)[1]
    along, across = np.array([[np.cos(1.0), np.sin(1.0), 0.3], [-np.sin(1.0), np.cos(1.0), 0.0]])
    np.testing.assert_allclose(mirror @ along, along)
    np.testing.assert_allclose(mirror @ across, -across)


@pytest.mark.parametrize(
    ("answer", "seen", "azimuth"),
    [
        ("answers its jerk", see(0.1 * np.arange(STEPS)), 0.0),  # it turns evenly, so the push is along its course
        ("answers the sum of its turns", see(4.0 - np.arange(STEPS)), 0.6 * 6),  # almost a whole turn
        ("copies like a relay", see(np.full(STEPS, 0.7)), 0.0),
        ("copies like a relay", see(np.array([0.7, 0.64, 0.58, 0.52, 0.3, 0.0, 0.0])), 0.7),  # sharp, then less
        ("copies like a relay", see(np.array([0.7, 0.64, 0.58, 0.52, 0.46, 0.4, 0.34])), 0.0),  # never sharp
        ("copies like a relay", see(np.array([0.7, 0.7, 0.7, 0.7, 0.4, 0.0, 0.0])), 0.0),  # sharp, then straight
        ("keeps its bearing", see(np.full(STEPS, 0.7)), 0.0),
        ("reads its climb", see(climb=0.2), 1.0 + 2.25 * 0.2),
        ("copies its sharpest turn", see(np.array([0.9, 0.85, 0.8, 0.75, 0.1, 0.07, 0.0])), 0.8),
    ],
)
def test_an_answer_is_the_course_that_its_words_say(answer, seen, azimuth):
    wanted = ANSWERS[answer](LAW, seen)
    found = np.arctan2(wanted[:, 1], wanted[:, 0])
    np.testing.assert_allclose(np.cos(found - azimuth), 1.0, atol=1e-3)


def test_a_follower_turns_with_the_bearing_and_against_a_push():
    left = np.linspace(0.2, 0.0, STEPS)
    bearing = np.stack([np.cos(left), np.sin(left), 0 * left], axis=1)
    wanted = ANSWERS["keeps its bearing"](LAW, see(ahead=bearing))
    np.testing.assert_allclose(wanted, [[1.0, 4.5 * np.sin(0.2), 0.0]] * 9)
    jerk = see(np.array([0.2, 0.1, 0.0, 0.0, 0.0, 0.0, 0.0]))
    np.testing.assert_allclose(ANSWERS["answers its jerk"](LAW, jerk)[:, 1], 0.9 * np.sin(0.2))


def test_the_strength_swings_sees_and_tires():
    swing = np.array([STRENGTH["in a rhythm"](LAW, see(clock=t)) for t in range(48)])
    np.testing.assert_allclose(swing[12:], swing[:-12])  # a period of 6 + 2 delay
    assert (swing.min(axis=0) < 0.25).all()
    assert (swing.max(axis=0) > 0.95).all()
    view = STRENGTH["within its view"]
    assert [float(view(LAW, see(ahead=(x, 0.0, 0.0)))[0, 0]) for x in (1.0, -0.5, -0.6)] == [1.0, 1.0, 0.2]
    calm, turning = (STRENGTH["with fatigue"](LAW, see(turn * np.arange(STEPS))) for turn in (0.0, 0.1))
    np.testing.assert_allclose(calm, 1.0)
    np.testing.assert_allclose(turning, np.exp(-5 * 0.2))  # five turns of two steps
