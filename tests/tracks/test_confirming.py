"""Confirmed leaders: a lead counts, what happens at the same time doesn't, and no follower is called a leader."""

from itertools import product

import numpy as np
import pytest
from track_files import Answers, Sure, answer_of, tracks_of

from usnet_env import Window
from usnet_env.tracks import confirm, find_leaders

STEPS, UAVS = 200, 6


def wander(rng):
    return np.cumsum(rng.normal(0, 0.3, (STEPS, 2)), axis=0) * 0.2 + rng.normal(0, 1, (STEPS, 2))


def confirmed(velocities, head=0, seen=None, **options):
    """The windows in which ``head`` is named, of two."""
    tracks = tracks_of(np.cumsum(np.stack(velocities, axis=1), axis=0), seen=seen).resample(1.0)
    found = find_leaders(tracks, Sure(head), length=99, **options)
    assert len(found.windows) == 2
    return sum(bool(window.leaders) for window in found.windows)


def followers_of(rng, leader, delay, gain=1.0, noise=0.3):
    return [gain * np.roll(leader, delay, axis=0) + rng.normal(0, noise, leader.shape) for _ in range(UAVS - 1)]


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("delay", [-2, 0, 1, 4])
def test_a_leader_is_confirmed_at_every_delay_of_the_test_and_only_there(seed, delay):
    rng = np.random.default_rng(seed)
    leader = wander(rng)
    velocities = [leader, *followers_of(rng, leader, delay)]
    assert confirmed(velocities) == (2 if delay > 0 else 0)
    assert confirmed(velocities, confirm=False) == 2


def test_gaps_and_a_leader_that_comes_late_do_not_matter():
    rng = np.random.default_rng(3)
    leader = wander(rng)
    seen = rng.random((STEPS, UAVS)) > 0.1
    seen[:30, 0] = False
    seen[0] = seen[-1] = True
    assert confirmed([leader, *followers_of(rng, leader, 2)], seen=seen) == 2


def test_relays_opposite_velocities_and_independent_tracks_are_not_confirmed():
    rng = np.random.default_rng(1)
    leader = wander(rng)
    assert confirmed([leader, *followers_of(rng, leader, 2, gain=-1.0)]) == 0
    relay = np.roll(leader, 2, axis=0) + rng.normal(0, 0.1, leader.shape)
    assert confirmed([leader, relay, *followers_of(rng, relay, 1)[1:]], head=1) == 0
    assert sum(confirmed([wander(rng) for _ in range(UAVS)], head=k % UAVS) for k in range(20)) <= 4


def set_off(order, lateral, instants=120, wait=12):
    """A window in which ids set off one after another, each on a straight way of its own at some lateral distance."""
    gone = np.maximum(0.0, np.arange(instants)[:, None] - 5 - wait * np.array(order))
    ways = lateral * np.random.default_rng(2).normal(0, 1, len(order)) + 0 * gone
    position = np.stack([gone, ways, 0 * gone], axis=2)
    return window_of(position + np.random.default_rng(3).normal(0, 0.05, position.shape))


def window_of(position):
    """A window of positions ``(T + 1, N, 3)``, with a step of 1 s."""
    position = position.astype(np.float32)
    seen = np.ones(position.shape[:2], bool)
    return Window(position, np.diff(position, axis=0), seen, seen[0], step=1.0)


def test_ids_that_set_off_later_on_the_same_way_follow_the_places_of_the_first():
    """One follows another; a detector may name as leader of all the one that the others follow directly or not."""
    for order in ([0, 1, 2, 3], [2, 0, 1, 3]):
        first, rest = order.index(0), [k for k in range(4) if order[k]]
        confirmed_ones, kept = confirm.confirm_leaders(set_off(order, 0.5), [first], [rest])
        assert (confirmed_ones.tolist(), kept) == ([True], [rest])
        second = order.index(1)
        assert confirm.keep_path_followers(set_off(order, 0.5), second, [k for k in range(4) if order[k] > 1]) == []
    assert confirm.keep_path_followers(set_off([0, 1, 2, 3], 40.0), 0, [1, 2, 3]) == [1, 2, 3]  # side by side
    assert confirm.keep_path_followers(set_off([0, 3, 3.1, 3.2], 0.5), 0, [1, 2, 3]) == []  # later than 30 s
    assert confirm.keep_path_followers(set_off([0, 0.02, 0.01, 0.03], 0.5), 0, [1, 2, 3]) == []  # at once


def test_straight_ways_at_one_speed_tell_nothing_of_a_leader():
    """In whole numbers, at a speed that they hold exactly or hardly, or with noise."""
    for speed, noise in product((1.0, 1.3), (0.0, 0.05)):
        gone = np.floor(speed * np.arange(101)) if not noise else speed * np.arange(101)
        position = np.zeros((101, 6, 3))
        position[..., 0], position[..., 1] = gone[:, None] + 7 * np.arange(6), 1000 * np.arange(6)
        window = window_of(position + np.random.default_rng(5).normal(0, noise, position.shape))
        for leader in range(6):
            assert confirm.keep_path_followers(window, leader, [k for k in range(6) if k != leader]) == []


def test_leaders_of_short_windows_are_confirmed():
    """In 32 steps, the trends of all hide who is first; changes of their velocity help to show it."""
    right = wrong = abrupt = 0
    for seed in range(20):
        rng = np.random.default_rng(seed)
        leader, free = walk(rng, 34), rng.normal(0, 1, (36, 2))
        velocity = np.array([leader[2:], *(leader[1:-1] for _ in range(3)), *(leader[:-2] for _ in range(2))])
        window = make_window(velocity + rng.normal(0, 0.03, velocity.shape))
        right += confirm.confirm_leaders(window, [0], [[1, 2, 3, 4, 5]])[0][0]
        wrong += confirm.confirm_leaders(window, [4], [[0, 1, 2, 3, 5]])[0][0]
        late = np.array([free[4:], *[free[:-4]] * 3])
        abrupt += confirm.confirm_leaders(make_window(late + rng.normal(0, 0.5, late.shape)), [0], [[1, 2, 3]])[0][0]
    assert (right >= 13, wrong, abrupt >= 15) == (True, 0, True)


def go_along(seed, uavs=6, steps=100):
    """A window of UAVs that go along one winding way, each at a changing pace of its own."""
    rng = np.random.default_rng(seed)
    way = np.cumsum(walk(rng, 4 * steps), axis=0)
    pace = 1.0 + 0.1 * np.cumsum(rng.normal(0, 1, (steps, uavs)), axis=0) / 10
    gone = rng.uniform(0, steps / 4, uavs) + np.cumsum(pace, axis=0)
    place = np.stack([np.interp(gone, np.arange(len(way)), axis) for axis in way.T], axis=2)
    return make_window(np.diff(place, axis=0).transpose(1, 0, 2), place[0])


def test_what_is_followed_instead_of_a_leader_is_named():
    """A way; an unseen signal, with noise of their own; or nothing: walks in the open, and in a small arena."""
    found = {"one path": 0, "one signal": 0, "walks": 0, "arena": 0}
    for seed in range(8):
        rng = np.random.default_rng(seed)
        signal = walk(rng, 105)
        hidden = np.array([signal[k % 4 : k % 4 + 100] for k in range(6)]) + rng.normal(0, 0.1, (6, 100, 2))
        walks = np.array([walk(rng, 100) for _ in range(6)])
        bounded = 5 * np.sin(np.cumsum(walks, axis=1) / 5)  # reflected at the walls
        start = rng.uniform(-30, 30, (6, 2))
        windows = {"one path": go_along(seed), "one signal": make_window(hidden, start)}
        windows |= {"walks": make_window(walks, start), "arena": make_window(np.diff(bounded, axis=1), bounded[:, 0])}
        for words, window in windows.items():
            confound, alike = confirm.find_confound(window)
            assert bool(confound) == bool(alike)
            found[words] += confound == words if words in ("one path", "one signal") else bool(confound)
    assert found["one path"] >= 7
    assert found["one signal"] >= 7
    assert found["walks"] + found["arena"] <= 1
    tracks = tracks_of(go_along(0).position, names=range(6)).resample(1.0)
    found = find_leaders(tracks, "none", length=99)
    assert (found.windows[0].confound, found.windows[0].alike) == ("one path", tuple(range(6)))
    sentence = "In 1 of 1 window no leader is found, and 6 ids go along one path, each at a pace of its own."
    assert str(found) == f"No leader was found.\n{sentence}"


def names_the_first(followers=None):
    """Names the first id, and gives it as leader to itself and to the next ones."""

    def answer(uavs, _):
        return answer_of(uavs, 0, np.where(np.arange(uavs) <= (uavs if followers is None else followers), 0, -1))

    return Answers(answer)


def walk(rng, steps):
    course = np.cumsum(rng.normal(0, 0.25, steps))
    return np.stack([np.cos(course), np.sin(course)], axis=1)


def group(seed, followers, others, steps, shared):
    """``followers`` copy id 0 after 1 to 3 steps; ``others`` share a route of their own, or have one each."""
    rng = np.random.default_rng(seed)
    head, route = walk(rng, steps), walk(rng, steps)
    velocity = [head, *(np.roll(head, 1 + k % 3, axis=0) for k in range(followers))]
    velocity += [route if shared else walk(rng, steps) for _ in range(others)]
    place = np.cumsum(np.array(velocity) + rng.normal(0, 0.1, (len(velocity), steps, 2)), axis=1) / 2
    return tracks_of(place.swapaxes(0, 1), 0.5, names=range(len(place))).resample(0.5)


def test_an_independent_group_is_removed_from_the_followers():
    windows = [w for seed in range(4) for w in find_leaders(group(seed, 4, 5, 402, True), names_the_first()).windows]
    named = [window.leaders[0].followers for window in windows if window.leaders]
    assert len(named) >= 0.7 * len(windows)
    assert sum(set(range(1, 5)) <= set(followers) for followers in named) >= 0.8 * len(named)
    assert sum(max(followers) > 4 for followers in named) <= 0.2 * len(named)


def test_a_head_of_a_small_group_does_not_follow_independent_ids():
    """Among many independent ids, some are like the head by chance."""
    found = [find_leaders(group(seed, 2, 300, 502, False), names_the_first(followers=2)).windows for seed in range(3)]
    assert sum(len(window.leaders) for windows in found for window in windows) >= 0.8 * sum(map(len, found))


def make_window(velocity, start=0.0):
    """A window of velocities ``(N, T, 2)``, from places ``(N, 2)`` on."""
    moved = np.cumsum(np.pad(velocity.swapaxes(0, 1), ((1, 0), (0, 0), (0, 0))), axis=0)
    return window_of(np.pad(start + moved, ((0, 0), (0, 0), (0, 1))))


def test_a_uav_that_follows_one_outside_its_group_is_rejected_at_any_lead():
    """UAV 0 follows UAV 1 in the first half, and UAV 2 in the second; a member of its own group needs a clear lead."""
    outside = inside = 0
    for seed in range(40):
        rng = np.random.default_rng(seed)
        first, second = walk(rng, 100), walk(rng, 100)
        head = np.concatenate([np.roll(first, 1, axis=0)[:50], np.roll(second, 1, axis=0)[50:]])
        velocity = np.array([head, first, second, np.roll(head, 1, axis=0), np.roll(head, 2, axis=0)])
        window = make_window(velocity + rng.normal(0, 0.3, velocity.shape))
        outside += confirm.find_followers(window, [0], [[3, 4]])[0]
        inside += confirm.find_followers(window, [0], [[1, 2, 3, 4]])[0]
    assert outside >= 34
    assert inside <= 20


def follow(steps, delays, *, seed=0, gain=1.0):
    """Positions ``(T, 1 + n, 2)`` of a leader, the first, and of n ids that copy its velocity so many steps later."""
    rng = np.random.default_rng(seed)
    drawn = rng.normal(0, 1, (steps + max(delays) + 12, 2))
    velocity = np.apply_along_axis(np.convolve, 0, drawn, np.ones(12) / 12**0.5, "valid")[: steps + max(delays)]
    late = [velocity[max(delays) - lag :][:steps] for lag in (0, *delays)]
    moved = np.stack([late[0], *(gain * each + rng.normal(0, 0.25, each.shape) for each in late[1:])], axis=1)
    return np.cumsum(moved, axis=0) + rng.normal(0, 5, (1, len(late), 2)) + rng.normal(0, 0.05, moved.shape)


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
    tracks = tracks_of(moving[whole] + still) if rests else tracks_of(moving, times=at)
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
    assert text.startswith("No leader is confirmed in a whole window; one is found for a part of the time.\n")
    assert "From 0.0: a1 leads " in text
    assert "The nearest candidate is" in text


def test_a_window_is_read_in_halves_where_its_leader_changes():
    first, second = follow(150, [2, 3, 3, 4, 2]), follow(150, [2, 3, 3, 4, 2], seed=1)
    order = [1, 0, 2, 3, 4, 5]
    position = np.concatenate([first, first[-1] + second[:, order] - second[0, order]])
    found = find_leaders(tracks_of(position))
    assert names(found) == {"a0", "a1"}
    record, steps = found.to_episode(), [each.window.observation_steps for each in found.track_windows]
    assert record.seen.any(axis=2).sum(axis=1).tolist() == [1 + count for count in steps]
    assert len({*steps}) > 1


def walk_weakly(seed, gain):
    """Positions ``(T, 5, 2)`` of ids that repeat the first one's velocity, with a motion of their own of 1 m a step."""
    rng = np.random.default_rng(seed)
    head = wander(rng)
    late = (gain * np.roll(head, 1 + k % 3, axis=0) + rng.normal(0, 1, head.shape) for k in range(4))
    return np.cumsum([head, *late], axis=1).swapaxes(0, 1)


def count_led(positions):
    """Windows of 64 steps in which the first id is confirmed."""
    found = [find_leaders(tracks_of(part).resample(1.0), names_the_first(), length=64) for part in positions]
    return sum(bool(window.leaders) for each in found for window in each.windows)


def test_weak_leaders_are_confirmed_together_with_the_windows_before_and_after():
    files = [walk_weakly(seed, 0.5)[:129] for seed in range(10)]
    apart, joined = count_led([part[k : k + 65] for part in files for k in (0, 64)]), count_led(files)
    assert apart <= 12 < 15 <= joined  # of 20


def test_ids_that_none_follows_are_not_confirmed_in_longer_windows_either():
    assert count_led([walk_weakly(seed, 0.0)[:193] for seed in range(8)]) <= 2  # of 24
