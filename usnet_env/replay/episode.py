"""The neutral episode file: all observations, the truth and all answers of one episode, in no viewer's format."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from usnet_env.config import ArgumentError, format_count, is_whole_number, plain_text, quote, whole_number
from usnet_env.drawing import last_seen_position
from usnet_env.objectives import hits_and_redundant
from usnet_env.replay.episode_file import read_episode_file, write_episode_file
from usnet_env.window import frozen_array

MOST_SEED = 2**128 - 1  # the seeds that NumPy draws from the operating system have 128 bits
_LINKS = "communication_links"  # derived from ``root`` when a file is written, compared when it is read


def _freeze_indices(name: str, value: Any, shape: tuple[int, int], high: int) -> NDArray[np.int64]:
    """Convert ``value`` to read-only int64; refuse numbers that are not whole or not within -1 to ``high``."""
    exact = frozen_array(name, value, np.float64, shape)
    if not ((exact >= -1) & (exact <= high) & (exact == np.floor(exact))).all():
        raise ArgumentError(f"{name} must hold whole numbers from -1 to {high}, got {quote(np.asarray(value))}.")
    return frozen_array(name, value, np.int64, shape)


def _convert_to_json(name: str, value: Mapping[str, Any]) -> dict[str, Any]:
    """Convert a mapping to what JSON holds, so that saving and loading changes nothing."""
    try:
        if not isinstance(value, Mapping):
            raise TypeError
        plain: dict[str, Any] = json.loads(json.dumps(dict(value), allow_nan=False))
    except (TypeError, ValueError):
        raise ArgumentError(f"{name} must map names to plain values that JSON holds, got {quote(value)}.") from None
    return plain


def _list_links(
    followed: NDArray[np.int64], followers: NDArray[np.bool_], heads: NDArray[np.bool_]
) -> NDArray[np.int64]:
    """``(L, 2)`` int64: which of ``followers`` ``(N,)`` follow which of ``heads`` ``(N,)``."""
    linked = np.flatnonzero(followers & (followed >= 0) & heads[followed] & (followed != np.arange(len(followed))))
    return np.column_stack([linked, followed[linked]])


def _convert_to_texts(name: str, value: Any, rounds: int) -> tuple[dict[str, str], ...]:
    """Check texts of every round, each by the name of what it is about."""
    good = isinstance(value, Sequence) and len(value) == rounds and all(isinstance(each, Mapping) for each in value)
    if not good or not all(isinstance(word, str) for each in value for word in (*each, *each.values())):
        raise ArgumentError(f"{name} must hold for each of {rounds} rounds a mapping of texts, got {quote(value)}.")
    return tuple(dict(each) for each in value)


@dataclass(frozen=True, eq=False, repr=False)
class EpisodeRecord:
    """One episode of R rounds with N UAVs: the observer's windows, the truth, and the detector's answers.

    Arrays are read-only copies. Their first axis counts the rounds, except in ``head``, ``decoy`` and ``observers``.
    ``alive`` and ``root`` hold for the window of the round, before the round's candidates are destroyed.

    The cluster graph of the paper's §II-A, (nodes, edges, X), is computed from these arrays:
    :meth:`communication_links` gives the edges, :meth:`topology_matrix` gives X of equation (5), and
    :meth:`hierarchy` gives the edges that the detector found.

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
        leader_estimate: ``(R, N)`` int64, index of the UAV that each UAV follows by the detector's answer (-1: none),
            or ``None``.
        attention: ``(R, N, N)`` float32, the detector's attention weights: row i holds the weights of UAV i on all
            UAVs (the paper's α_{i,i'}); or ``None``.
        attention_heads: ``(R, H, N, N)`` float32, the weights of each of the detector's H attention heads, or ``None``.
        probability: ``(R, N)`` float64, the detector's probability that each UAV is a head, or ``None``.
        features: ``(R, N, 2)`` float32, the feature space in which the detector clustered, in the plane of its two
            principal axes; or ``None``.
        reasons: for each round a sentence by UAV (``"17"``): why the detector takes it for a head; or ``None``.
        choices: for each round a text by agent: what the agents of a game of several agents chose, or ``None``.
        observers: ``(K, 4)`` float64, position and sensing range of each observer in metres, or ``None``.
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
        ArgumentError: an array has another shape or impossible values, or two rounds contradict each other.
    """

    position: NDArray[np.float32]
    velocity: NDArray[np.float32]
    seen: NDArray[np.bool_]
    alive: NDArray[np.bool_]
    root: NDArray[np.int64]
    candidates: NDArray[np.bool_]
    scores: NDArray[np.float64]
    objective: NDArray[np.float64]
    head: NDArray[np.bool_]
    decoy: NDArray[np.bool_]
    over_budget: NDArray[np.bool_]
    seconds: NDArray[np.float64]
    clusters: NDArray[np.int64] | None = None
    leader_estimate: NDArray[np.int64] | None = None
    attention: NDArray[np.float32] | None = None
    attention_heads: NDArray[np.float32] | None = None
    probability: NDArray[np.float64] | None = None
    features: NDArray[np.float32] | None = None
    reasons: Sequence[Mapping[str, str]] | None = None
    choices: Sequence[Mapping[str, str]] | None = None
    observers: NDArray[np.float64] | None = None
    problem: str = "P2"
    env_id: str = ""
    seed: int | None = None
    detector: str = ""
    detector_seed: int | None = None
    config: Mapping[str, Any] = field(default_factory=dict)
    versions: Mapping[str, Any] = field(default_factory=dict)
    labelled: bool = True

    def __repr__(self) -> str:
        return (
            f"<EpisodeRecord of {self.env_id or 'a game'}: {format_count(self.rounds, 'round')}, {self.uavs} UAVs, "
            f"detector {self.detector!r}, seed {self.seed}>"
        )

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
        forms: dict[str, tuple[type, tuple[int | None, ...]]] = {
            "velocity": (np.float32, (rounds, instants - 1, uavs, 3)),
            "seen": (bool, (rounds, instants, uavs)),
            "alive": (bool, (rounds, uavs)),
            "candidates": (bool, (rounds, uavs)),
            "head": (bool, (uavs,)),
            "decoy": (bool, (uavs,)),
            "over_budget": (bool, (rounds,)),
            "objective": (np.float64, (rounds,)),
            "seconds": (np.float64, (rounds,)),
            "scores": (np.float64, (rounds, uavs)),
            "attention": (np.float32, (rounds, uavs, uavs)),
            "attention_heads": (np.float32, (rounds, None, uavs, uavs)),
            "probability": (np.float64, (rounds, uavs)),
            "features": (np.float32, (rounds, uavs, 2)),
            "observers": (np.float64, (None, 4)),
        }
        highest = {"root": uavs - 1, "clusters": 2**53, "leader_estimate": uavs - 1}
        absent = {item.name for item in fields(self) if item.default is None and getattr(self, item.name) is None}
        for name, (kind, shape) in forms.items():
            if name not in absent:
                put(name, frozen_array(name, getattr(self, name), kind, shape))
        for name, high in highest.items():
            if name not in absent:
                put(name, _freeze_indices(name, getattr(self, name), (rounds, uavs), high))
        for name in ("reasons", "choices"):
            if name not in absent:
                put(name, _convert_to_texts(name, getattr(self, name), rounds))
        self._check_labels()
        for name in ("config", "versions"):
            put(name, _convert_to_json(name, getattr(self, name)))
        self._check_rounds()

    def _check_labels(self) -> None:
        if not isinstance(self.problem, str) or self.problem not in ("P1", "P2"):
            raise ArgumentError(f"problem must be 'P1' or 'P2', got {quote(self.problem)}.")
        if not isinstance(self.labelled, bool):
            raise ArgumentError(f"labelled must be true or false, got {quote(self.labelled)}.")
        for name in ("env_id", "detector"):
            plain_text(name, getattr(self, name))
        for name in ("seed", "detector_seed"):
            if (value := getattr(self, name)) is not None:
                object.__setattr__(self, name, whole_number(name, value, 0, MOST_SEED))

    def _check_rounds(self) -> None:
        if (self.head & self.decoy).any():
            raise ArgumentError(
                f"decoy must exclude the heads, got UAVs {quote(np.flatnonzero(self.head & self.decoy))} as both."
            )
        left = self.alive & ~self.destroyed
        if not np.array_equal(self.alive[1:], left[:-1]):
            raise ArgumentError("alive must be, in every later round, what the previous round left; it is not.")

    @property
    def rounds(self) -> int:
        """R, the rounds played."""
        return int(self.position.shape[0])

    @property
    def uavs(self) -> int:
        """N, destroyed UAVs included."""
        return int(self.position.shape[2])

    @property
    def recorded(self) -> bool:
        """Whether the episode is of recorded tracks, with the truth or without: nothing in them is destroyed."""
        # Files that an earlier version wrote of this environment have no ids.
        return not self.labelled or "ids" in self.config or self.env_id == "USNET/Tracks-v0"

    @property
    def destroyed(self) -> NDArray[np.bool_]:
        """``(R, N)`` bool: UAVs that are destroyed in each round."""
        return self.fired & (not self.recorded)

    @property
    def fired(self) -> NDArray[np.bool_]:
        """``(R, N)`` bool: candidates that were shot at; none in a round over budget."""
        return self.candidates & ~self.over_budget[:, None]

    @property
    def decoys(self) -> NDArray[np.bool_]:
        """``(R, N)`` bool: living decoys, also those of one window in the game of evasion, which lead themselves."""
        return self.alive & ~self.head & (self.decoy | (self.root == np.arange(self.uavs)))

    @property
    def orphans(self) -> NDArray[np.bool_]:
        """``(R, N)`` bool: living followers whose head is destroyed in the round."""
        behind = np.take_along_axis(self.destroyed, np.maximum(self.root, 0), axis=1)
        return self.alive & ~self.destroyed & (self.root >= 0) & behind

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

    def _index(self, number: int) -> int:
        """Index of a round; refuses a number that is no round."""
        return whole_number("number", number, 1, self.rounds) - 1

    def last_position(self, number: int) -> NDArray[np.float32]:
        """Where each UAV was seen last, up to the end of a round.

        Args:
            number: the round, from 1.

        Returns:
            ``(N, 3)`` metres; NaN for a UAV that was never seen.

        Raises:
            ArgumentError: no such round.
        """
        rounds = self._index(number) + 1
        position = self.position[:rounds].reshape(-1, self.uavs, 3)
        return last_seen_position(position, self.seen[:rounds].reshape(-1, self.uavs))

    def communication_links(self, number: int) -> NDArray[np.int64]:
        """The true communication links of a round: the paper's edge sets E_{j,t} of all clusters, §II-A.

        Args:
            number: the round, from 1.

        Returns:
            ``(L, 2)`` int64: a row for each living follower, its index and the index of its head, in ascending order of
            the followers. The graph is undirected.

        Raises:
            ArgumentError: no such round.
        """
        r = self._index(number)
        return _list_links(self.root[r], self.alive[r], self.head & self.alive[r])

    def hierarchy(self, number: int) -> NDArray[np.int64] | None:
        """The hierarchy graph that the detector found in a round: links to its candidates.

        A living UAV that is no candidate is linked to the candidate that ``leader_estimate`` names. If the detector
        gave no leaders, its attention decides: the UAV's leader is the other UAV with the largest weight. A UAV without
        a leader, or with a leader that is no candidate, has no link.

        Args:
            number: the round, from 1.

        Returns:
            ``(L, 2)`` int64: index of the UAV and of its candidate, in ascending order of the UAVs; ``None`` if the
            record has neither ``leader_estimate`` nor ``attention``. The same form as :meth:`communication_links`.

        Raises:
            ArgumentError: no such round.
        """
        r = self._index(number)
        candidates = self.candidates[r] & self.alive[r]
        if self.leader_estimate is not None:
            leader = self.leader_estimate[r]
        elif self.attention is not None:
            others = np.where(np.eye(self.uavs, dtype=bool), 0.0, self.attention[r])
            leader = np.where(others.max(axis=1) > 0, others.argmax(axis=1), -1)
        else:
            return None
        return _list_links(leader, self.alive[r] & ~candidates, candidates)

    def topology_matrix(
        self, number: int, t: int, head: int | None = None, memory: int | None = None
    ) -> NDArray[np.float32]:
        """The time series topology matrix X of equation (5) at velocity ``t`` of a round's window.

        Three rows (x, y, z) for each UAV, in ascending order of the UAVs. The columns are the position p_{i,t-T_0+1}
        and the T_0 velocities v_{i,t-T_0+1}, …, v_{i,t}. Unseen samples are 0, as in the window. The paper counts 3m_j
        rows; here the head of the cluster has its three rows, too.

        Args:
            number: the round, from 1.
            t: index of the newest velocity, from T_0 - 1 to T_ob - 1.
            head: index of a living head: the rows of its cluster, that is the head and its m_j followers, in this
                round. ``None``: the rows of all N UAVs.
            memory: T_0; ``None``: the environment's, which ``config`` holds.

        Returns:
            ``(3(m_j + 1), T_0 + 1)`` float32, or ``(3N, T_0 + 1)`` without ``head``; metres in the first column, metres
            per step in the others.

        Raises:
            ArgumentError: no such round, time or living head, or T_0 is not known.
        """
        r = self._index(number)
        steps = self.velocity.shape[1]
        past = whole_number("memory", self.config.get("memory") if memory is None else memory, 1, steps)
        t = whole_number("t", t, past - 1, steps - 1)
        members = np.arange(self.uavs)
        if head is not None:
            living = np.flatnonzero(self.head & self.alive[r])
            if not is_whole_number(head) or head not in living.tolist():
                raise ArgumentError(f"head must be one of the living heads {quote(living)}, got {quote(head)}.")
            members = np.flatnonzero(self.alive[r] & ((self.root[r] == head) | (members == head)))
        first = t - past + 1
        position = self.position[r, first, members][:, :, None]
        velocity = np.moveaxis(self.velocity[r, first : t + 1][:, members], 0, -1)
        return np.concatenate([position, velocity], axis=-1).reshape(3 * len(members), past + 1)

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the record as one compressed ``.npz``; the file appears whole.

        The file also holds ``communication_links`` ``(L, 3)`` int64 for readers without this class: round, follower
        and head of every true link.

        Args:
            path: the file to write; an existing file is replaced.

        Returns:
            The path.

        Raises:
            ArgumentError: the place can't be written to.
        """
        values = {item.name: getattr(self, item.name) for item in fields(self)}
        arrays: dict[str, Any] = {name: value for name, value in values.items() if isinstance(value, np.ndarray)}
        words = {name: values[name] for name in values if name not in arrays and values[name] is not None}
        return write_episode_file(path, words, {**arrays, _LINKS: self._all_links()})

    def _all_links(self) -> NDArray[np.int64]:
        """``(L, 3)`` round, follower and head of every communication link of the episode."""
        each = [self.communication_links(number) for number in range(1, self.rounds + 1)]
        numbers = np.repeat(np.arange(1, self.rounds + 1), [len(links) for links in each])
        return np.column_stack([numbers, np.concatenate(each)])

    @classmethod
    def load(cls, path: str | os.PathLike[str], *, max_bytes: int | None = None) -> EpisodeRecord:
        """Read a record; nothing in the file is ever executed.

        Args:
            path: a file that :meth:`save` of this or an earlier version wrote.
            max_bytes: the largest number of bytes that the arrays may need in memory. The file is compressed, so a
                small file can hold very large arrays. ``None``: 256 MiB, or 20 times the size of the file if that is
                more.

        Returns:
            The record; every array and text equals the saved one. Fields that an earlier version did not have are
            ``None``.

        Raises:
            ArgumentError: the file does not exist, is of another kind or a newer version, is damaged, or holds more
                than ``max_bytes``.
        """
        most = None if max_bytes is None else whole_number("max_bytes", max_bytes, 1)
        where, words, arrays = read_episode_file(path, most)
        try:
            version = words.pop("version")
            links = arrays.pop(_LINKS) if version > 1 else None
            if version < 5:
                arrays["root"] = arrays.pop("leader")
            record = cls(**words, **arrays)
            if links is not None and not np.array_equal(links, record._all_links()):
                raise ArgumentError(f"{_LINKS} must agree with root; it does not.")
            return record
        except KeyError as error:
            raise ArgumentError(f"path must be an intact episode file, got {where}: {error} is missing.") from None
        except (ArgumentError, TypeError) as error:  # TypeError: a field is missing, doubled or unknown
            raise ArgumentError(f"path must be an intact episode file, got {where}: {error}") from None


def check_record(record: Any) -> EpisodeRecord:
    """Return the argument ``record``; raise :class:`ArgumentError` if it is not an :class:`EpisodeRecord`."""
    if not isinstance(record, EpisodeRecord):
        raise ArgumentError(f"record must be an EpisodeRecord, got {quote(record)}.")
    return record
