"""The window: the observation of one round, the only input of a detector."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from usnet_env.arrays import Mask, Singles
from usnet_env.config import ArgumentError, quote, real_number, whole_number

_VALUES = {"b": "only 0 and 1 (or booleans)", "i": "whole numbers", "f": "finite numbers that its type can hold"}


def as_array(name: str, value: Any) -> NDArray[Any]:
    """Return the argument ``name`` as an array of any shape and type; a ragged list or a masked value is refused."""
    if np.ma.is_masked(value):
        raise ArgumentError(f"{name} must be an array without masked values, got {quote(value)}.")
    try:
        return np.asarray(value)
    except (TypeError, ValueError, RuntimeError) as error:  # the last one from a tensor that requires a gradient
        reason = str(error).rstrip(".")
        raise ArgumentError(f"{name} must be an array, got {quote(value)}: {reason}.") from None


def frozen_array(name: str, value: ArrayLike, dtype: type, shape: tuple[int | None, ...]) -> NDArray[Any]:
    """A read-only copy of the argument ``name`` in ``dtype``; ``None`` in ``shape`` allows any length of an axis.

    Values that are not finite or that ``dtype`` can't hold are refused: a 2 for ``bool``, a fraction for ``int``.
    """
    array = as_array(name, value)
    if array.ndim != len(shape) or any(
        length not in (None, size) for length, size in zip(shape, array.shape, strict=True)
    ):
        expected = str(shape).replace("None", "any")
        raise ArgumentError(f"{name} must have shape {expected}, got {array.shape if array.ndim else quote(value)}.")
    numbers = array if array.dtype.kind in "biuf" else np.full(array.shape, np.nan)
    with np.errstate(over="ignore", invalid="ignore"):  # numbers that the cast changes are refused below
        copy: NDArray[Any] = numbers.astype(dtype, copy=True)
    is_held = np.isfinite(copy) if copy.dtype.kind == "f" else copy == numbers
    if not is_held.all():
        raise ArgumentError(f"{name} must hold {_VALUES[copy.dtype.kind]}, got {quote(value)}.")
    copy.setflags(write=False)
    return copy


def _scalar(name: str, value: Any) -> Any:
    """The number in an array of size 1, as an ``int`` if it is whole; any other value is returned as it is."""
    array = as_array(name, value)
    number = array.item() if array.size == 1 else value
    return int(number) if isinstance(number, float) and number.is_integer() else number


@dataclass(frozen=True, eq=False)
class Window:
    """Positions and velocities of N UAVs at T_ob + 1 sampling instants, with masks.

    All arrays are read-only copies. Samples that were not detected, and samples of destroyed UAVs, are 0 and masked.
    Velocity ``t`` leads from position ``t`` to position ``t + 1`` (decision (d) on docs/game.md); it is valid where
    :attr:`velocity_seen` is true.

    Args:
        position: ``(T_ob + 1, N, 3)`` float32, metres.
        velocity: ``(T_ob, N, 3)`` float32, metres per step.
        seen: ``(T_ob + 1, N)`` bool, whether the UAV was detected at that instant.
        alive: ``(N,)`` bool, false for destroyed UAVs.
        round: number of the detection round; the first round is 1.
        step: seconds between two instants, or ``None`` in a simulation, whose steps have no length in seconds.

    Raises:
        ArgumentError: an array has another shape or non-finite values, or a mask has values other than 0 and 1.

    >>> position = np.cumsum(np.ones((11, 4, 3)), axis=0)
    >>> window = Window(position, np.diff(position, axis=0), seen=np.ones((11, 4)), alive=np.ones(4), step=0.2)
    >>> window.uavs, window.observation_steps
    (4, 10)
    """

    position: Singles
    velocity: Singles
    seen: Mask
    alive: Mask
    round: int = 1
    step: float | None = None

    def __post_init__(self) -> None:
        position = frozen_array("position", self.position, np.float32, (None, None, 3))
        instants, uavs = position.shape[:2]
        if instants < 2 or uavs < 1:
            raise ArgumentError(f"position must hold at least 2 instants of 1 UAV, got shape {position.shape}.")
        checked = {
            "position": position,
            "velocity": frozen_array("velocity", self.velocity, np.float32, (instants - 1, uavs, 3)),
            "seen": frozen_array("seen", self.seen, bool, (instants, uavs)),
            "alive": frozen_array("alive", self.alive, bool, (uavs,)),
            "round": whole_number("round", self.round, 1),
            "step": None if self.step is None else real_number("step", self.step, 1e-9, 1e9),
        }
        for name, value in checked.items():
            object.__setattr__(self, name, value)

    def __repr__(self) -> str:
        step = f" of {self.step:g} s" if self.step else ""
        destroyed = f", {int((~self.alive).sum())} destroyed" * (not self.alive.all())
        return f"<Window of {self.uavs} UAVs, {self.observation_steps} steps{step}, round {self.round}{destroyed}>"

    @property
    def uavs(self) -> int:
        """N, the number of UAVs, destroyed UAVs included."""
        return int(self.position.shape[1])

    @property
    def observation_steps(self) -> int:
        """T_ob, the number of velocity samples."""
        return int(self.velocity.shape[0])

    @property
    def velocity_seen(self) -> Mask:
        """``(T_ob, N)`` bool: the UAV is alive and was detected at both ends of the step."""
        return self.seen[:-1] & self.seen[1:] & self.alive

    @classmethod
    def from_observation(cls, observation: Mapping[str, Any]) -> Window:
        """Make the window of an observation. A detector gets all its information about an environment this way.

        Args:
            observation: has the keys ``position, velocity, seen, alive, round`` and, for recorded tracks, ``step``.

        Raises:
            ArgumentError: a key lacks, or a value is refused.

        >>> import gymnasium, usnet_env
        >>> observation, info = gymnasium.make("USNET/MultiCluster-v0").reset(seed=0)
        >>> Window.from_observation(observation).uavs
        82
        """
        keys = ("position", "velocity", "seen", "alive", "round")
        if not isinstance(observation, Mapping) or any(key not in observation for key in keys):
            got = list(observation) if isinstance(observation, Mapping) else observation
            raise ArgumentError(f"observation must be a mapping with the keys {', '.join(keys)}, got {quote(got)}.")
        scalars = {key: _scalar(key, observation[key]) for key in ("round", "step") if key in observation}
        return cls(**{key: observation[key] for key in keys[:-1]}, **scalars)
