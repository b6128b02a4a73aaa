"""The neutral episode file: all observations, the truth and all answers of one episode, in no viewer's format."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from usnet_env.arrays import Floats, Indices, Mask, Singles
from usnet_env.config import ArgumentError, quote
from usnet_env.detection import Detection
from usnet_env.drawing import last_seen_position
from usnet_env.files import as_path, atomic_write, describe_fault
from usnet_env.objectives import find_candidates, hits_and_redundant
from usnet_env.provenance import versions
from usnet_env.window import Window

if TYPE_CHECKING:
    from usnet_env.swarm import SwarmState

FORMAT_VERSION = 1
_FORMAT = "usnet-episode"
_LINKS = "communication_links"  # derived from ``root`` when a file is written, for readers without this class
_DTYPES = {"Singles": np.float32, "Floats": np.float64, "Indices": np.int64, "Mask": np.bool_}
#: The axes of the arrays that are not (R, N): I instants, T steps, O observers, K intruders.
_SHAPES = {"position": "RIN3", "velocity": "RTN3", "seen": "RIN", "attention": "RNN", "observers": "O4"}
_SHAPES |= {"intruders": "RIK3", "objective": "R", "over_budget": "R", "seconds": "R", "head": "N", "decoy": "N"}


def _check_shape(name: str, array: NDArray[Any], sizes: dict[str, int]) -> None:
    """Refuse an array whose axes are not those of ``_SHAPES``, with the known ``sizes``; add the sizes of new axes."""
    axes = _SHAPES.get(name, "RN")
    expected = ", ".join(str(sizes.get(axis, axis)) for axis in axes)
    sizes |= dict(zip(axes, array.shape, strict=False)) | sizes
    if array.shape != tuple(sizes[axis] for axis in axes if axis in sizes):
        raise ArgumentError(f"{name} must have shape ({expected}), got {array.shape}.")


def _list_links(root: Indices, followers: Mask, heads: Mask) -> Indices:
    """``(L, 2)``: which of ``followers`` ``(N,)`` follow which of ``heads`` ``(N,)``."""
    linked = np.flatnonzero(followers & (root >= 0) & heads[root] & (root != np.arange(len(root))))
    return np.column_stack([linked, root[linked]])


def _stack_values(values: Sequence[ArrayLike | None], absent: int = 0) -> Any:
    """Stack an optional part of the answers; it is full of ``absent`` where a round lacks it, ``None`` if all do."""
    first = next((value for value in values if value is not None), None)
    if first is None:
        return None
    return np.stack([np.full_like(first, absent) if value is None else value for value in values])


def _list_reasons(answer: Detection) -> dict[str, str]:
    """The sentences of ``extras["reasons"]`` by the UAVs of ``extras["heads"]``."""
    heads, reasons = answer.extras.get("heads", ()), answer.extras.get("reasons", ())
    return {str(int(i)): str(reason) for i, reason in zip(heads, reasons, strict=False)}


@dataclass(frozen=True, eq=False, repr=False)
class EpisodeRecord:
    """One episode of R rounds with N UAVs: the observer's windows, the truth, and the detector's answers.

    Arrays are read-only copies. ``alive`` and ``root`` hold for the window of the round, before the round's candidates
    are destroyed.

    Args:
        position: ``(R, T_ob + 1, N, 3)`` float32, metres, as observed; 0 where unseen.
        velocity: ``(R, T_ob, N, 3)`` float32, metres per step, as observed.
        seen: ``(R, T_ob + 1, N)`` bool.
        alive: ``(R, N)`` bool.
        root: ``(R, N)`` int64, index of the head that each UAV truly follows; heads and decoys have their own index;
            -1: no head is left.
        candidates: ``(R, N)`` bool, Ĥ_r.
        scores: ``(R, N)`` float64, the detector's; higher is more head-like.
        objective: ``(R,)`` float64, J after the round.
        head: ``(N,)`` bool, H_0.
        decoy: ``(N,)`` bool.
        over_budget: ``(R,)`` bool, the round had more candidates than the shot budget, and no UAV was destroyed.
        seconds: ``(R,)`` float64, wall time of ``detect`` alone.
        clusters: ``(R, N)`` int64, the detector's cluster labels (-1: none), or ``None``.
        leader_estimate: ``(R, N)`` int64, the UAV that each follows by the answer (-1: none), or ``None``.
        attention: ``(R, N, N)`` float32, row i holds the attention weights of UAV i on all UAVs (the paper's
            α_{i,i'}); it and the arrays and texts below may be ``None``.
        probability: ``(R, N)`` float64, the detector's probability that each UAV is a head.
        reasons: for each round a sentence by UAV (``"17"``): why the detector takes it for a head.
        choices: for each round a text by agent: what the agents of a game of several agents chose.
        observers: ``(K, 4)`` float64, position and sensing range of each observer in metres.
        intruders: ``(R, T_ob + 1, K, 3)`` float32, metres, the tracks of the intruders that an observer steered.
        problem: ``"P1"`` or ``"P2"``.
        env_id: the environment's registered id.
        seed: the environment's seed; ``None``: not seeded.
        detector: the detector's label.
        detector_seed: the detector's seed; ``None``: not seeded.
        config: the environment's arguments, as JSON holds them.
        versions: version of Python and of each package that computed the episode.
        labelled: whether the truth is known. In recorded tracks it is not: then ``head`` and ``root`` hold what the
            detector found, the UAVs that are candidates in a round and the candidate that each UAV follows.

    Raises:
        ArgumentError: an array has another shape, or JSON can't hold a value.
    """

    position: Singles
    velocity: Singles
    seen: Mask
    alive: Mask
    root: Indices
    candidates: Mask
    scores: Floats
    objective: Floats
    head: Mask
    decoy: Mask
    over_budget: Mask
    seconds: Floats
    clusters: Indices | None = None
    leader_estimate: Indices | None = None
    attention: Singles | None = None
    probability: Floats | None = None
    reasons: Sequence[Mapping[str, str]] | None = None
    choices: Sequence[Mapping[str, str]] | None = None
    observers: Floats | None = None
    intruders: Singles | None = None
    problem: str = "P2"
    env_id: str = ""
    seed: int | None = None
    detector: str = ""
    detector_seed: int | None = None
    config: Mapping[str, Any] = field(default_factory=dict)
    versions: Mapping[str, Any] = field(default_factory=dict)
    labelled: bool = True

    def __repr__(self) -> str:
        size = f"{self.rounds} rounds, {self.uavs} UAVs"
        return f"<EpisodeRecord: {self.detector} on {self.env_id}, {size}, seed {self.seed}>"

    def __post_init__(self) -> None:
        sizes: dict[str, int] = {"3": 3, "4": 4}
        for item in fields(self):
            value, kind = getattr(self, item.name), _DTYPES.get(str(item.type).partition(" ")[0])
            try:
                if kind is not None and (value is not None or item.default is MISSING):
                    value = np.array(value, kind)
                    value.setflags(write=False)
                elif kind is None and not isinstance(value, str):  # so that saving and loading changes nothing
                    value = json.loads(json.dumps(value))
            except (TypeError, ValueError, RuntimeError) as error:
                raise ArgumentError(f"{item.name} can't be kept, got {quote(value)}: {error}.") from None
            if isinstance(value, np.ndarray):
                _check_shape(item.name, value, sizes)
            object.__setattr__(self, item.name, value)

    @classmethod
    def from_rounds(
        cls,
        windows: Sequence[Window],
        answers: Sequence[Detection],
        truths: Sequence[SwarmState] | None = None,
        **arguments: Any,
    ) -> EpisodeRecord:
        """Make the record of R rounds.

        Args:
            windows: a window of all N UAVs for each round.
            answers: the detector's answer to each window.
            truths: the swarm in each round; ``None``: the truth is unknown, so that ``head`` and ``root`` are those of
                the answers, no UAV is destroyed, and J is 0.
            arguments: other arguments of the class by name, such as ``objective`` and ``env_id``.

        Raises:
            ArgumentError: an argument has another shape or can't be kept.
        """
        candidates, rounds = np.stack([answer.candidates for answer in answers]), len(windows)
        reasons = [_list_reasons(answer) for answer in answers]
        arrays: dict[str, Any] = {
            **{name: [getattr(window, name) for window in windows] for name in ("position", "velocity", "seen")},
            "candidates": candidates,
            "scores": [answer.scores for answer in answers],
            "clusters": _stack_values([answer.clusters for answer in answers], absent=-1),
            "leader_estimate": _stack_values([answer.leader for answer in answers], absent=-1),
            "attention": _stack_values([answer.attention for answer in answers]),
            "probability": _stack_values([answer.extras.get("probability") for answer in answers]),
            "reasons": reasons if any(reasons) else None,
            "seconds": np.zeros(rounds),
            "versions": versions(),
            "labelled": truths is not None,
        }
        if truths is None:
            arrays |= {"alive": [window.alive for window in windows], "root": [*map(find_candidates, answers)]}
            arrays |= {"head": candidates.any(axis=0), "decoy": np.zeros(candidates.shape[1], bool)}
            arrays |= {"objective": np.zeros(rounds), "over_budget": np.ones(rounds, bool)}
        else:
            arrays |= {name: [getattr(truth, name) for truth in truths] for name in ("alive", "root")}
            arrays |= {"head": truths[0].head, "decoy": truths[0].decoy}
        return cls(**arrays | arguments)

    @property
    def rounds(self) -> int:
        """R."""
        return int(self.position.shape[0])

    @property
    def uavs(self) -> int:
        """N, destroyed UAVs included."""
        return int(self.position.shape[2])

    @property
    def recorded(self) -> bool:
        """Whether the episode is of recorded tracks, with the truth or without: nothing in them is destroyed."""
        return not self.labelled or "ids" in self.config

    @property
    def destroyed(self) -> Mask:
        """``(R, N)`` bool: UAVs that are destroyed in each round."""
        return self.fired & (not self.recorded)

    @property
    def fired(self) -> Mask:
        """``(R, N)`` bool: candidates that were shot at; none in a round over budget."""
        return self.candidates & ~self.over_budget[:, None]

    @property
    def decoys(self) -> Mask:
        """``(R, N)`` bool: living decoys, also those of one window in the game of evasion, which lead themselves."""
        return self.alive & ~self.head & (self.decoy | (self.root == np.arange(self.uavs)))

    @property
    def orphans(self) -> Mask:
        """``(R, N)`` bool: living followers whose head is destroyed in the round."""
        is_head_destroyed = np.take_along_axis(self.destroyed, np.maximum(self.root, 0), axis=1)
        return self.alive & ~self.destroyed & (self.root >= 0) & is_head_destroyed

    @property
    def hits(self) -> Indices:
        """``(R,)`` heads hit in each round."""
        return hits_and_redundant(self.head, self.alive, self.fired)[0]

    @property
    def redundant(self) -> Indices:
        """``(R,)`` redundant candidates of each round."""
        return hits_and_redundant(self.head, self.alive, self.fired)[1]

    @property
    def heads_left(self) -> Indices:
        """``(R,)`` living heads after each round."""
        return np.asarray((self.head & self.alive & ~self.fired).sum(axis=1))

    def last_position(self, number: int) -> Singles:
        """Where each UAV was seen last, up to the end of a round (from 1): ``(N, 3)`` metres, NaN if never."""
        position, seen = self.position[:number], self.seen[:number]
        return last_seen_position(position.reshape(-1, self.uavs, 3), seen.reshape(-1, self.uavs))

    def communication_links(self, number: int) -> Indices:
        """``(L, 2)``: the living followers of a round (from 1) and their living heads, the paper's E_{j,t}, §II-A."""
        alive = self.alive[number - 1]
        return _list_links(self.root[number - 1], alive, self.head & alive)

    def hierarchy(self, number: int) -> Indices | None:
        """``(L, 2)``: the living UAVs of a round (from 1) and the candidates that they follow by the answer."""
        if self.leader_estimate is None:
            return None
        alive, candidates = self.alive[number - 1], self.candidates[number - 1]
        return _list_links(self.leader_estimate[number - 1], alive & ~candidates, alive & candidates)

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the record as one compressed ``.npz``, in place of an existing file; the file appears whole.

        The file also holds ``communication_links`` ``(L, 3)`` int64: round, follower and head of every true link.

        Raises:
            ArgumentError: the place can't be written to.
        """
        arrays: dict[str, Any] = {name: value for name, value in vars(self).items() if isinstance(value, np.ndarray)}
        metadata = {name: value for name, value in vars(self).items() if name not in arrays and value is not None}
        links = [np.insert(self.communication_links(n), 0, n, axis=1) for n in range(1, self.rounds + 1)]
        text = json.dumps({**metadata, "format": _FORMAT, "version": FORMAT_VERSION})
        with atomic_write(path) as temporary, temporary.open("wb") as file:
            np.savez_compressed(file, **arrays | {_LINKS: np.concatenate(links), "metadata": np.array(text)})
        return Path(path)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> EpisodeRecord:
        """Read a file that :meth:`save` wrote; nothing in it is ever executed.

        Raises:
            ArgumentError: the file can't be read, is of another kind or version, or is damaged.
        """
        file_path = as_path("path", path)
        try:
            with file_path.open("rb") as source, np.load(source, allow_pickle=False) as file:
                arrays: dict[str, Any] = {name: file[name] for name in file.files if name != _LINKS}
            metadata = json.loads(str(arrays.pop("metadata")))
            version = metadata.pop("version") if metadata.pop("format") == _FORMAT else None
            if version != FORMAT_VERSION:
                raise ValueError(f"version {quote(version)} is not known, only {FORMAT_VERSION}")
            return cls(**metadata, **arrays)
        except Exception as error:  # a damaged file makes NumPy raise whatever Python's own tokenizer raises
            raise ArgumentError(describe_fault(file_path, "episode file", error)) from None
