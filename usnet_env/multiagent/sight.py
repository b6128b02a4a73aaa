"""What each of K observers sees of one swarm: a place, a range, and sensing noise of its own."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Annotated, Any, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from usnet_env.config import ArgumentError, Config, quote, unknown_name
from usnet_env.swarm import ObservationBatch, SwarmConfig
from usnet_env.swarm.formation import ARENA
from usnet_env.swarm.sensing import sense

__all__ = ["Eye", "Sight", "observe_from", "placements", "team_sight"]

Number = Annotated[float, Field(ge=0, le=1e6)]
Share = Annotated[float, Field(ge=0, lt=1)]
Generators = Sequence[np.random.Generator]


class Sight(Config):
    """The observers of one swarm, and what each of them sees. Lengths in metres.

    Args:
        observers: K.
        sensing_range: a UAV is seen up to this distance from the observer; one number for all, or one for each.
        position_noise: standard deviation of the observed positions per axis, drawn apart for every observer; one
            number for all, or one for each.
        miss_rate: probability that a UAV in range is not detected at a sampling instant; one for all, or one for each.
        placement: where the observers stand: ``"grid"`` or ``"uniform"``.
        message_size: numbers that every observer sends to all others in a round; 0: none.

    Raises:
        ArgumentError: a value of another type or out of its range, or a list whose length is not K.
    """

    observers: Annotated[int, Field(ge=1, le=1000)] = 4
    sensing_range: Number | tuple[Number, ...] = 500.0
    position_noise: Annotated[float, Field(ge=0, le=1000)] | tuple[Annotated[float, Field(ge=0, le=1000)], ...] = 0.0
    miss_rate: Share | tuple[Share, ...] = 0.0
    placement: str = "grid"
    message_size: Annotated[int, Field(ge=0, le=100_000)] = 0

    @model_validator(mode="after")
    def _one_for_each(self) -> Self:
        for name in ("sensing_range", "position_noise", "miss_rate"):
            value = getattr(self, name)
            if isinstance(value, tuple) and len(value) != self.observers:
                raise ArgumentError(
                    f"{name} must be one number, or one for each of {self.observers} observers, got {quote(value)}."
                )
        if self.placement not in _PLACEMENTS:
            raise unknown_name("placement", self.placement, _PLACEMENTS)
        return self

    def each(self, name: str) -> tuple[float, ...]:
        """The K values of ``sensing_range``, ``position_noise`` or ``miss_rate``."""
        value = getattr(self, name)
        return value if isinstance(value, tuple) else (value,) * self.observers

    def sensors(self, config: SwarmConfig) -> list[SwarmConfig]:
        """For every observer, the swarm with that observer's noise and missed detections."""
        parts = {name: getattr(config, name) for name in SwarmConfig.model_fields}
        return [
            SwarmConfig(**(parts | {"position_noise": noise, "miss_rate": miss}))
            for noise, miss in zip(self.each("position_noise"), self.each("miss_rate"), strict=True)
        ]

    def places(self, rng: np.random.Generator) -> NDArray[np.float64]:
        """``(K, 3)`` metres: where the observers stand in an episode."""
        return _PLACEMENTS[self.placement](rng, self.observers)


@dataclass(frozen=True)
class Eye:
    """One observer in an episode.

    Args:
        place: ``(3,)`` metres.
        reach: its sensing range, metres.
        sensor: the swarm as it samples it: noise, missed detections, sampling.
        rng: the generator of its own noise.
    """

    place: NDArray[np.float64]
    reach: float
    sensor: SwarmConfig
    rng: np.random.Generator


def observe_from(
    eye: Eye, position: NDArray[np.float32], velocity: NDArray[np.float32], alive: NDArray[np.bool_]
) -> ObservationBatch:
    """The window of one observer: what :func:`usnet_env.swarm.sensing.sense` gives, and only what is in range.

    Args:
        eye: the observer.
        position: ``(T_ob * k + 1, N, 3)`` float32, the true positions at every step of the window.
        velocity: ``(T_ob * k, N, 3)`` float32, the true velocities.
        alive: ``(N,)`` bool.

    Returns:
        The sighting without a leading axis; the true distance decides what is in range.
    """
    sighting = sense(eye.sensor, position[None], velocity[None], alive[None], [eye.rng])
    away = np.linalg.norm(position[:: eye.sensor.sample_every] - eye.place, axis=-1)
    seen = sighting.seen[0] & (away <= eye.reach)
    both = seen[1:] & seen[:-1]
    return ObservationBatch(
        position=np.where(seen[..., None], sighting.position[0], np.float32(0.0)),
        velocity=np.where(both[..., None], sighting.velocity[0], np.float32(0.0)),
        seen=seen,
        alive=alive.copy(),
    )


def team_sight(sightings: Sequence[ObservationBatch]) -> ObservationBatch:
    """What the observers saw together: for every sample, that of the first observer who has it.

    Args:
        sightings: K sightings without a leading axis.

    Returns:
        One sighting, for pictures and records; no agent gets it.
    """
    first = sightings[0]
    position, velocity, seen = first.position, first.velocity, first.seen
    moved = seen[1:] & seen[:-1]
    for other in sightings[1:]:
        position = np.where(seen[..., None], position, other.position)
        both = other.seen[1:] & other.seen[:-1]
        velocity = np.where(moved[..., None], velocity, other.velocity)
        seen, moved = seen | other.seen, moved | both
    return ObservationBatch(position, velocity, seen, first.alive.copy())


def _grid(_rng: np.random.Generator, observers: int) -> NDArray[np.float64]:
    """Spread evenly: the middles of equal fields of the arena, as square as K allows, at half its height."""
    rows = max(d for d in range(1, int(observers**0.5) + 1) if observers % d == 0)
    columns = observers // rows
    x = (np.arange(columns) + 0.5) / columns * ARENA[0]
    y = (np.arange(rows) + 0.5) / rows * ARENA[1]
    middle = np.full(observers, ARENA[2] / 2)
    return np.stack([np.tile(x, rows), np.repeat(y, columns), middle], axis=1)


def _uniform(rng: np.random.Generator, observers: int) -> NDArray[np.float64]:
    """Anywhere in the arena, drawn for each episode."""
    return rng.uniform(0.0, ARENA, (observers, 3))


_PLACEMENTS: dict[str, Callable[[np.random.Generator, int], NDArray[np.float64]]] = {
    "grid": _grid,
    "uniform": _uniform,
}


def placements() -> Mapping[str, Callable[[np.random.Generator, int], NDArray[Any]]]:
    """All placements ``(rng, K) -> (K, 3)`` metres, by name (a read-only view)."""
    return MappingProxyType(_PLACEMENTS)
