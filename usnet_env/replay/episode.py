"""The neutral episode file: everything that was seen, true and decided in one episode, without any viewer's format."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from usnet_env.config import ArgumentError, quote
from usnet_env.drawing import last_seen_position
from usnet_env.files import atomic_write
from usnet_env.objectives import hits_and_redundant
from usnet_env.window import frozen_array

__all__ = ["FORMAT_VERSION", "EpisodeRecord"]

FORMAT_VERSION = 1
_FORMAT = "usnet-episode"
_METADATA = "metadata"


def _whole_numbers(name: str, value: Any, shape: tuple[int | None, ...], low: int, high: int) -> NDArray[np.int64]:
    """``value`` as int64, refused unless every number is whole and within ``low`` to ``high``."""
    exact = frozen_array(name, value, np.float64, shape)
    if not ((exact >= low) & (exact <= high) & (exact == np.floor(exact))).all():
        raise ArgumentError(f"{name} must hold whole numbers from {low} to {high}, got {quote(np.asarray(value))}.")
    return frozen_array(name, value, np.int64, shape)


def _plain(name: str, value: Mapping[str, Any]) -> dict[str, Any]:
    """A mapping as JSON holds it, so that saving and loading changes nothing."""
    try:
        if not isinstance(value, Mapping):
            raise TypeError
        plain: dict[str, Any] = json.loads(json.dumps(dict(value), allow_nan=False))
    except (TypeError, ValueError):
        raise ArgumentError(f"{name} must map names to plain values that JSON holds, got {quote(value)}.") from None
    return plain


@dataclass(frozen=True, eq=False)
class EpisodeRecord:
    """One episode of R rounds with N UAVs: what the observer saw, the truth, and what the detector answered.

    Arrays are read-only copies; their first axis counts the rounds. ``alive`` and ``leader`` are those of the window,
    before the round's candidates are destroyed.

    Args:
        position: ``(R, T_ob + 1, N, 3)`` float32, metres, as observed; 0 where unseen.
        velocity: ``(R, T_ob, N, 3)`` float32, metres per step, as observed.
        seen: ``(R, T_ob + 1, N)`` bool.
        alive: ``(R, N)`` bool.
        leader: ``(R, N)`` int64, whom each UAV truly follows; a head's or decoy's own index, -1: nobody is left.
        candidates: ``(R, N)`` bool, Ĥ_r.
        scores: ``(R, N)`` float64, the detector's; higher is more head-like.
        objective: ``(R,)`` float64, J after the round.
        head: ``(N,)`` bool, H_0.
        decoy: ``(N,)`` bool.
        over_budget: ``(R,)`` bool, more candidates than the shot budget: nobody was destroyed.
        seconds: ``(R,)`` float64, wall time of ``detect`` alone.
        clusters: ``(R, N)`` int64, the detector's cluster labels (-1: none), or ``None``.
        leader_estimate: ``(R, N)`` int64, whom each UAV is thought to follow (-1: nobody), or ``None``.
        problem: ``"P1"`` or ``"P2"``.
        env_id: the environment's registered id.
        seed: what the environment was reset with; ``None``: not seeded.
        detector: the detector's label.
        detector_seed: what the detector was reset with.
        config: the environment's arguments, as JSON holds them.
        versions: versions of what computed this, by package.

    Raises:
        ArgumentError: an array of another shape or with impossible values, or rounds that contradict each other.
    """

    position: NDArray[np.float32]
    velocity: NDArray[np.float32]
    seen: NDArray[np.bool_]
    alive: NDArray[np.bool_]
    leader: NDArray[np.int64]
    candidates: NDArray[np.bool_]
    scores: NDArray[np.float64]
    objective: NDArray[np.float64]
    head: NDArray[np.bool_]
    decoy: NDArray[np.bool_]
    over_budget: NDArray[np.bool_]
    seconds: NDArray[np.float64]
    clusters: NDArray[np.int64] | None = None
    leader_estimate: NDArray[np.int64] | None = None
    problem: str = "P2"
    env_id: str = ""
    seed: int | None = None
    detector: str = ""
    detector_seed: int | None = None
    config: Mapping[str, Any] = field(default_factory=dict)
    versions: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        def put(name: str, value: Any) -> None:
            object.__setattr__(self, name, value)

        position = frozen_array("position", self.position, np.float32, (None, None, None, 3))
        rounds, instants, uavs = position.shape[:3]
        if rounds < 1 or instants < 2 or uavs < 1:
            raise ArgumentError(
                "position must hold at least 1 round of at least 2 instants of at least 1 UAV, "
                f"got shape {position.shape}."
            )
        put("position", position)
        put("velocity", frozen_array("velocity", self.velocity, np.float32, (rounds, instants - 1, uavs, 3)))
        put("seen", frozen_array("seen", self.seen, bool, (rounds, instants, uavs)))
        for name in ("alive", "candidates"):
            put(name, frozen_array(name, getattr(self, name), bool, (rounds, uavs)))
        for name in ("head", "decoy"):
            put(name, frozen_array(name, getattr(self, name), bool, (uavs,)))
        put("over_budget", frozen_array("over_budget", self.over_budget, bool, (rounds,)))
        for name in ("objective", "seconds"):
            put(name, frozen_array(name, getattr(self, name), np.float64, (rounds,)))
        put("scores", frozen_array("scores", self.scores, np.float64, (rounds, uavs)))
        put("leader", _whole_numbers("leader", self.leader, (rounds, uavs), -1, uavs - 1))
        if self.clusters is not None:
            put("clusters", _whole_numbers("clusters", self.clusters, (rounds, uavs), -1, 2**53))
        if self.leader_estimate is not None:
            put(
                "leader_estimate", _whole_numbers("leader_estimate", self.leader_estimate, (rounds, uavs), -1, uavs - 1)
            )
        self._check_words()
        for name in ("config", "versions"):
            put(name, _plain(name, getattr(self, name)))
        self._check_story()

    def _check_words(self) -> None:
        if self.problem not in ("P1", "P2"):
            raise ArgumentError(f"problem must be 'P1' or 'P2', got {quote(self.problem)}.")
        for name in ("env_id", "detector"):
            if not isinstance(getattr(self, name), str):
                raise ArgumentError(f"{name} must be a text, got {quote(getattr(self, name))}.")
        for name in ("seed", "detector_seed"):
            value = getattr(self, name)
            if value is not None and (isinstance(value, bool) or not isinstance(value, int)):
                raise ArgumentError(f"{name} must be a whole number or None, got {quote(value)}.")

    def _check_story(self) -> None:
        if (self.head & self.decoy).any():
            raise ArgumentError(
                f"decoy must exclude the heads, got UAVs {quote(np.flatnonzero(self.head & self.decoy))} as both."
            )
        left = self.alive & ~self.fired
        if not np.array_equal(self.alive[1:], left[:-1]):
            raise ArgumentError("alive must be, in every later round, what the round before left; it is not.")

    @property
    def rounds(self) -> int:
        """R, the rounds played."""
        return int(self.position.shape[0])

    @property
    def uavs(self) -> int:
        """N, destroyed UAVs included."""
        return int(self.position.shape[2])

    @property
    def fired(self) -> NDArray[np.bool_]:
        """``(R, N)`` bool: candidates that were shot at, nobody in a round over budget."""
        return self.candidates & ~self.over_budget[:, None]

    @property
    def hits(self) -> NDArray[np.int64]:
        """``(R,)`` heads hit in each round."""
        return hits_and_redundant(self.head, self.alive, self.fired)[0]

    @property
    def redundant(self) -> NDArray[np.int64]:
        """``(R,)`` redundant candidates of each round."""
        return hits_and_redundant(self.head, self.alive, self.fired)[1]

    @property
    def heads_left(self) -> NDArray[np.int64]:
        """``(R,)`` living heads after each round."""
        return np.asarray((self.head & self.alive & ~self.fired).sum(axis=1))

    def last_position(self, number: int) -> NDArray[np.float32]:
        """Where each UAV was seen last, up to the end of a round.

        Args:
            number: the round, from 1.

        Returns:
            ``(N, 3)`` metres; NaN for a UAV that was never seen.
        """
        place = np.full((self.uavs, 3), np.nan, np.float32)
        for position, seen in zip(self.position[:number], self.seen[:number], strict=True):
            place = np.where(np.any(seen, axis=0, keepdims=True).T, last_seen_position(position, seen), place)
        return place

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the record as one compressed ``.npz``; the file appears whole.

        Args:
            path: where to; an existing file is replaced.

        Returns:
            The path.

        Raises:
            ArgumentError: the place can't be written to.
        """
        values = {item.name: getattr(self, item.name) for item in fields(self)}
        arrays: dict[str, Any] = {name: value for name, value in values.items() if isinstance(value, np.ndarray)}
        words = {name: values[name] for name in values if name not in arrays and values[name] is not None}
        words |= {"format": _FORMAT, "version": FORMAT_VERSION}
        with atomic_write(path) as aside, aside.open("wb") as file:
            np.savez_compressed(file, **arrays | {_METADATA: np.array(json.dumps(words))})
        return Path(path)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> EpisodeRecord:
        """Read a record back; nothing in the file is ever executed.

        Args:
            path: a file that :meth:`save` wrote.

        Returns:
            The record, equal to the one saved in every array and word.

        Raises:
            ArgumentError: no such file, a file of another kind, a damaged one, or one of a newer format.
        """
        where = quote(os.fspath(path))
        foreign = ArgumentError(f"path must be an episode file of this project, got {where}.")
        try:
            with open(path, "rb") as file:
                loaded = np.load(file, allow_pickle=False)
                if not isinstance(loaded, np.lib.npyio.NpzFile) or _METADATA not in loaded.files:
                    raise foreign
                arrays: dict[str, Any] = {name: loaded[name] for name in loaded.files}
            words = json.loads(str(arrays.pop(_METADATA)))
        except ArgumentError:
            raise
        except FileNotFoundError:
            raise ArgumentError(f"path must be an episode file, got {where}, which does not exist.") from None
        except Exception as error:  # a damaged header makes NumPy raise whatever Python's own tokenizer raises
            why = " ".join(str(error).split()) or type(error).__name__
            raise ArgumentError(f"path must be an intact episode file, got {where}, not readable: {why}.") from None
        if not isinstance(words, dict) or words.pop("format", None) != _FORMAT:
            raise foreign
        version = words.pop("version", None)
        if version != FORMAT_VERSION:
            raise ArgumentError(
                f"path must be an episode file of version {FORMAT_VERSION}, got {where} of version {quote(version)}."
            )
        try:
            return cls(**words, **arrays)
        except (ArgumentError, TypeError) as error:  # TypeError: a field is missing, doubled or unknown
            raise ArgumentError(f"path must be an intact episode file, got {where}: {error}") from None
