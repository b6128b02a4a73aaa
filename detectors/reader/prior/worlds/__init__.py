"""Worlds that the simulator doesn't have: other laws of following, and many in which no UAV leads."""

from collections.abc import Callable

import numpy as np

from detectors.reader.examples import Examples
from detectors.reader.prior.families import draw_whole
from detectors.reader.prior.worlds import crowds, followers, formations, manoeuvres
from detectors.reader.prior.worlds.stage import Flight, Stage, finish


def _hide_first(rng: np.random.Generator, stage: Stage, law: Callable[..., Flight], *groups: int) -> Flight:
    """What remains to see of a flight whose leader is unseen: no UAV leads."""
    flight = law(rng, stage._replace(uavs=stage.uavs + 1), *groups)
    link = flight.link[:, 1:, 1:] if isinstance(flight.link, np.ndarray) else None
    return Flight(flight.position[:, :, 1:], np.arange(stage.uavs), link=link)


def _draw_driven(rng: np.random.Generator, stage: Stage) -> Flight:
    law = followers.draw_star if rng.random() < 0.65 else followers.draw_path
    return _hide_first(rng, stage, law, 1)


#: The law of each world, its least and largest N, and the share of draws on a plane.
_LAWS: dict[str, tuple[Callable[[np.random.Generator, Stage], Flight], int, int, float]] = {
    "star": (followers.draw_star, 2, 40, 0.5),
    "graded": (followers.draw_graded, 3, 30, 0.5),
    "changes": (followers.draw_changes, 3, 40, 0.5),
    "fission": (followers.draw_fission, 6, 40, 0.5),
    "path": (followers.draw_path, 2, 40, 0.5),
    "set_off": (followers.draw_set_off, 2, 40, 0.5),
    "file": (followers.draw_file, 2, 15, 0.5),
    "convoy": (lambda rng, stage: followers.draw_file(rng, stage, closed=True), 3, 20, 1.0),
    "cars": (followers.draw_cars, 2, 30, 1.0),
    "initiators": (followers.draw_initiators, 2, 40, 0.8),
    "factions": (manoeuvres.draw_factions, 3, 40, 0.8),
    "turn_rate": (manoeuvres.draw_turn_rate, 2, 40, 0.5),
    "formation": (formations.draw_formation, 2, 30, 0.8),
    "people": (crowds.draw_people, 2, 30, 1.0),
    "springs": (crowds.draw_springs, 3, 12, 0.5),
    "boids_signed": (crowds.draw_boids_signed, 4, 40, 0.5),
    "driver": (_draw_driven, 4, 40, 0.5),
    "herd": (crowds.draw_herd, 4, 40, 0.8),
    "leaderless": (crowds.draw_leaderless, 2, 60, 0.5),
    "walkers": (crowds.draw_walkers, 2, 60, 0.5),
    "ring_road": (followers.draw_ring_road, 4, 30, 1.0),
    "strangers": (formations.draw_strangers, 2, 30, 0.8),
    "unled": (formations.draw_unled, 6, 60, 0.8),
    "driven": (formations.draw_driven, 6, 60, 0.8),
    "route": (followers.draw_route, 2, 40, 0.5),
    "springs_unseen": (lambda rng, stage: _hide_first(rng, stage, crowds.draw_springs), 3, 12, 0.5),
}
#: Often flown in finer steps, so that delays are no whole numbers.
_SAMPLED = ("star", "path", "driver", "route", "factions", "herd")


def fly_world(rng: np.random.Generator, name: str, windows: int, steps: int, most_uavs: int) -> Examples:
    """Draw windows of a world with equally many UAVs."""
    law, smallest, largest, p_plane = _LAWS[name]
    uavs = draw_whole(rng, smallest, max(smallest, min(largest, most_uavs * 3 // 4)))  # a quarter is left for lone UAVs
    stage = Stage(windows, steps, uavs, np.array([1.0, 1.0, 0.0 if rng.random() < p_plane else 1.0]))
    finer = int(rng.integers(2, 5)) if name in _SAMPLED and rng.random() < 0.4 else 1
    flight = law(rng, stage._replace(steps=finer * steps))
    delay = np.asarray(flight.delay) / finer
    return finish(rng, stage, flight._replace(position=flight.position[:, ::finer], delay=delay))
