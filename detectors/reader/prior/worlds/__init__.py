"""Worlds that the simulator doesn't have: other laws of following, and many in which nobody leads."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from detectors.reader.prior.draws import draw_whole
from detectors.reader.prior.motion import Motion
from detectors.reader.prior.worlds import copies, crowds, paths
from detectors.reader.prior.worlds.stage import Flight, Stage, finish


def _hide_first(rng: np.random.Generator, stage: Stage, law: Callable[..., Flight], *groups: int) -> Flight:
    """What remains to see of a flight whose leader nobody sees: nobody leads."""
    flight = law(rng, stage._replace(uavs=stage.uavs + 1), *groups)
    return Flight(flight.position[:, :, 1:], np.arange(stage.uavs))


def _draw_driven(rng: np.random.Generator, stage: Stage) -> Flight:
    laws = copies.draw_star, paths.draw_path, paths.draw_set_off
    return _hide_first(rng, stage, laws[int(rng.integers(3))], 1)


class World(NamedTuple):
    """How often a world is drawn, its law, its least and largest N, the share of planar draws, and of what else."""

    weight: float
    law: Callable[[np.random.Generator, Stage], Flight]
    uavs: tuple[int, int] = (2, 40)
    flat: float = 0.5
    bystanders: bool = True

    def draw(self, rng: np.random.Generator, windows: int, steps: int, most_uavs: int) -> Motion:
        """Draw the motions of windows with equally many UAVs."""
        least, most = self.uavs
        uavs = draw_whole(rng, least, max(least, min(most, most_uavs * 3 // 4)))  # a quarter is left for bystanders
        stage = Stage(windows, steps, uavs, np.array([1.0, 1.0, 0.0 if rng.random() < self.flat else 1.0]))
        return finish(rng, stage, self.law(rng, stage), self.bystanders)


#: The worlds by name; in the last seven nobody leads.
WORLDS = {
    "star": World(2.0, copies.draw_star),
    "graded": World(1.0, copies.draw_graded, (3, 30)),
    "changes": World(0.7, copies.draw_changes, (3, 40)),
    "fission": World(0.7, copies.draw_fission, (6, 40)),
    "path": World(2.0, paths.draw_path),
    "set_off": World(1.0, paths.draw_set_off),
    "file": World(1.0, paths.draw_file, (2, 15)),
    "convoy": World(0.5, lambda rng, stage: paths.draw_file(rng, stage, closed=True), (3, 20), 1.0),
    "cars": World(1.0, paths.draw_cars, (2, 30), 1.0),
    "initiators": World(1.2, paths.draw_initiators, (2, 40), 0.8),
    "people": World(1.5, crowds.draw_people, (2, 30), 1.0),
    "springs": World(1.5, crowds.draw_springs, (3, 12), bystanders=False),
    "boids_signed": World(1.0, crowds.draw_boids_signed, (4, 40)),
    "driver": World(2.0, _draw_driven, bystanders=False),
    "herd": World(1.5, crowds.draw_herd, (4, 40), 0.8, False),
    "leaderless": World(2.0, crowds.draw_leaderless, (2, 60), bystanders=False),
    "walkers": World(1.0, crowds.draw_walkers, (2, 60), bystanders=False),
    "ring_road": World(0.7, paths.draw_ring_road, (4, 30), 1.0, False),
    "route": World(1.0, paths.draw_route, bystanders=False),
    "springs_unseen": World(0.7, lambda rng, stage: _hide_first(rng, stage, crowds.draw_springs), (3, 12), 0.5, False),
}
