"""The K observers of a swarm: their places and sensors, and the rules that combine their votes into candidates."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from usnet_env.arrays import Floats, Indices, Mask, Observation
from usnet_env.config import ArgumentError, Config, quote
from usnet_env.swarm import ObservationBatch, SwarmConfig
from usnet_env.swarm.config import Few, Metres, Price, Rate
from usnet_env.swarm.formation import ARENA


class SensorConfig(Config):
    """The number of observers of a swarm, and their sensors: one number for all, or one for each. Lengths in metres."""

    observers: Annotated[int, Field(ge=1, le=1000)] = Field(4, description="K")
    sensing_range: Price | Sequence[Price] = Field(500.0, description="range of the observers, m; one for all, or each")
    position_noise: Metres | Sequence[Metres] = Field(0.0, description="standard deviation of positions, m; likewise")
    miss_rate: Rate | Sequence[Rate] = Field(0.0, description="probability of a missed detection in range; likewise")
    placement: Literal["grid", "uniform"] = Field("grid", description="places of the observers: ``grid``, ``uniform``")
    message_size: Few = Field(0, description="B, how many numbers each observer sends to all others in a round")
    observer_speed: Metres = Field(0.0, description="top speed of the observers, metres per step; 0: they stand")

    @model_validator(mode="after")
    def _check_lengths(self) -> Self:
        for name in ("sensing_range", "position_noise", "miss_rate"):
            value = getattr(self, name)
            if isinstance(value, tuple) and len(value) != self.observers:
                raise ArgumentError(
                    f"{name} must be one number, or one for each of {self.observers} observers, got {quote(value)}."
                )
        return self

    def expand(self, name: str) -> tuple[float, ...]:
        """The K values of ``sensing_range``, ``position_noise`` or ``miss_rate``."""
        value = getattr(self, name)
        return value if isinstance(value, tuple) else (value,) * self.observers

    def sensor_configs(self, config: SwarmConfig) -> list[SwarmConfig]:
        """The swarm's configuration for each observer, with its noise and miss rate."""
        return [
            config.part(SwarmConfig, position_noise=noise, miss_rate=miss)
            for noise, miss in zip(self.expand("position_noise"), self.expand("miss_rate"), strict=True)
        ]

    def draw_positions(self, rng: np.random.Generator) -> Floats:
        """The positions of the observers in an episode, ``(K, 3)`` metres, on a grid or uniform in the arena."""
        grid = self.placement == "grid"
        return _find_grid(self.observers) if grid else rng.uniform(0.0, ARENA, (self.observers, 3))


def fly_observers(place: Floats, velocity: Floats, steps: Indices) -> Floats:
    """Where observers are after some steps ``(T,)``; at the border of the arena they fly along it.

    Args:
        place: ``(..., 3)`` metres, where they begin.
        velocity: ``(..., 3)`` metres per step.
        steps: numbers of steps.

    Returns:
        ``(..., T, 3)`` metres.
    """
    return np.clip(place[..., None, :] + steps[:, None] * velocity[..., None, :], 0.0, ARENA)


def merge_windows(window: Observation, alive: Mask, sample_every: int) -> ObservationBatch:
    """Merge the windows ``(K, ...)`` of all observers: of each UAV, what the first observer that saw it has seen.

    A velocity whose ends different observers saw is the difference of the merged positions.
    """
    seen, moved = window["seen"], window["seen"][:, 1:] & window["seen"][:, :-1]
    position, velocity = (
        np.take_along_axis(window[name], is_seen.argmax(axis=0)[None, ..., None], axis=0)[0]
        for name, is_seen in (("position", seen), ("velocity", moved))
    )
    merged = np.asarray(seen.any(axis=0))
    apart = merged[1:] & merged[:-1] & ~moved.any(axis=0)  # two observers saw the two ends
    velocity = np.where(apart[..., None], np.diff(position, axis=0) / np.float32(sample_every), velocity)
    return ObservationBatch(position, velocity, merged, alive)


@cache
def _find_grid(observers: int) -> Floats:
    """The centres of K equal rectangles of the arena, at half its height."""
    rows = max(d for d in range(1, int(observers**0.5) + 1) if observers % d == 0)
    columns = observers // rows
    x = (np.arange(columns) + 0.5) / columns * ARENA[0]
    y = (np.arange(rows) + 0.5) / rows * ARENA[1]
    middle = np.full(observers, ARENA[2] / 2)
    return np.stack([np.tile(x, rows), np.repeat(y, columns), middle], axis=1)


def combine_votes(fusion: str, votes: Floats, seen: Mask) -> Mask:
    """Combine the votes of K observers into candidates, ``(..., N)`` bool.

    Args:
        fusion: ``"union"`` of the UAVs that they name, ``"majority"`` of the observers that saw a UAV, or ``"scores"``,
            whose mean over these observers must exceed 1/2.
        votes: ``(..., K, N)``, 0 or 1 for each UAV, or a score from 0 to 1; 0 for UAVs that an observer didn't see.
        seen: ``(..., K, N)``, the living UAVs that each observer saw.
    """
    if fusion == "union":
        return np.asarray((votes > 0.5).any(axis=-2))
    return np.asarray(votes.sum(axis=-2) > 0.5 * seen.sum(axis=-2))
