"""The roles in a swarm, the true state of a batch of swarms between two rounds, and how a destruction changes it."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from usnet_env.arrays import Floats, Indices, Mask, Singles
from usnet_env.swarm import kernels

Rows = NDArray[np.intp] | list[int] | slice

LASTING = ("head", "decoy", "root", "not_led", "source")  # the roles that :class:`SwarmState` keeps


def _pack(rows: Sequence[NDArray[Any]]) -> NDArray[Any]:
    """Arrays of several swarms as one with a leading axis; as an array of arrays, if swarms of several kinds differ."""
    if len(rows) == 1:
        return rows[0][None]
    if len({row.shape for row in rows}) == 1:
        return np.stack(rows)
    packed = np.empty(len(rows), object)
    for b, row in enumerate(rows):
        packed[b] = row
    return packed


def join_rows(parts: Sequence[NDArray[Any]]) -> NDArray[Any]:
    """One array of the rows of several ones."""
    if len(parts) == 1:
        return parts[0]
    if len({(part.shape[1:], part.dtype) for part in parts}) == 1:
        return np.concatenate(parts)
    return _pack([row for part in parts for row in part])


def find_each(mask: Mask) -> Indices:
    """The indices of the UAVs that are chosen in each swarm, ``(B, n)``; n is the same in all."""
    return np.asarray(np.nonzero(mask)[1].reshape(len(mask), -1))


class Roles(NamedTuple):
    """The role of every UAV in one swarm, or in B swarms with a leading axis B.

    ``head``, ``decoy``, ``root`` and ``not_led`` are those of :class:`SwarmState`.

    Args:
        traffic: ``(N,)`` bool, the bystanders that are civil traffic.
        clutter: ``(N,)`` bool, the bystanders that are false tracks, and no UAVs.
        source: ``(N,)`` int64, the UAV or reference that each UAV copies, at first its root.
        initial_heads: ``(M,)`` int64, the heads as drawn, in the order of the clusters.
    """

    head: Mask
    decoy: Mask
    root: Indices
    not_led: Mask
    traffic: Mask
    clutter: Mask
    source: Indices
    initial_heads: Indices

    def split(self) -> list[Self]:
        """The roles of each of B swarms."""
        return [type(self)(*rows) for rows in zip(*self, strict=True)]

    def members(self, cluster: int) -> Indices:
        """The followers of a cluster, as drawn, in the order of their indices."""
        head = self.initial_heads[cluster]
        return np.flatnonzero((self.root == head) & (np.arange(len(self.root)) != head))

    def without_heads(self, **changes: Any) -> Self:
        """These roles with changes, and without heads: the UAVs of the clusters have the root -1."""
        root = np.where(self.decoy | self.not_led, self.root, -1)
        return self._replace(**{"head": np.zeros_like(self.head), "root": root, **changes})


@dataclass(frozen=True)
class SwarmState:
    """The true state of B swarms between two rounds; :meth:`episode` gives one swarm without the leading axis.

    Besides its N UAVs a swarm may have R references, which no sensor sees: points of a field model that fly like heads,
    or with ``led_by`` the unseen UAVs above heads and decoys. Their indices are N to N + R - 1.

    Swarms of one batch may be of several kinds, with other follow strategies, mobilities or kinematics, if N and T_0
    are the same. Arrays whose shapes then differ are arrays ``(B,)`` of arrays.

    Args:
        head: ``(B, N)`` bool, H_0, the heads at the start, destroyed or not; none in a swarm that no UAV leads.
        decoy: ``(B, N)`` bool.
        alive: ``(B, N)`` bool, false for destroyed UAVs.
        root: ``(B, N)`` int64, the head of each follower (-1: it has none); the own index of a head, decoy or
            not_led.
        past_position: ``(B, T_0 + 1, N, 3)`` float32, metres, oldest first; 0 for destroyed UAVs.
        past_velocity: ``(B, T_0, N, 3)`` float32, metres per step.
        free: ``(B, n)`` int64, indices of the free UAVs: heads and decoys, unless unseen UAVs lead them, references,
            bystanders, traffic, then false tracks.
        mobility_state: ``(B, n, MOBILITY_STATE)`` float64, the mobility state of the free UAVs.
        parameters: ``(B, P)`` float32, parameters of the follow strategy.
        not_led: ``(B, N)`` bool, the UAVs that no head leads, decoys excluded: bystanders, traffic, false tracks,
            and the predators and drivers of a follow strategy.
        source: ``(B, N)`` int64, the UAV or reference that each UAV copies; for f1 to f7 its head.
        clock: ``(B,)`` int64, number of steps flown.
        kinematic_state: ``(B, N + R, k)`` float32, the state of each UAV's kinematics.
        reference_source: ``(B, R)`` int64, the reference that each reference copies; its own index if it is free.
        reference_position: ``(B, T_0 + 1, R, 3)`` float32, metres.
        reference_velocity: ``(B, T_0, R, 3)`` float32, metres per step.
    """

    head: Mask
    decoy: Mask
    alive: Mask
    root: Indices
    past_position: Singles
    past_velocity: Singles
    free: Indices
    mobility_state: Floats
    parameters: Singles
    not_led: Mask
    source: Indices
    clock: Indices
    kinematic_state: Singles
    reference_source: Indices
    reference_position: Singles
    reference_velocity: Singles

    @property
    def position(self) -> Singles:
        """``(B, N, 3)`` metres, the present positions."""
        return self.past_position[..., -1, :, :]

    @property
    def heads_left(self) -> Indices:
        """``(B,)`` number of living heads, |H_r|."""
        return np.asarray((self.head & self.alive).sum(axis=-1))

    @property
    def leader(self) -> Indices:
        """``(B, N)`` int64, the UAV that each UAV copies directly, itself for a head; where :attr:`root` is -1, -1."""
        uavs = np.arange(self.root.shape[-1])
        return np.where(self.root >= 0, np.where(self.root == uavs, uavs, self.source), -1)

    def roles(self) -> dict[str, NDArray[Any]]:
        """``alive``, ``head``, ``decoy`` and ``root`` by name, ``(B, N)`` each, as pictures take them; no copies."""
        return {name: getattr(self, name) for name in ("alive", "head", "decoy", "root")}

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Copies of all arrays by name, with the shapes above; ``SwarmState(**arrays)`` restores the state."""
        return {field.name: getattr(self, field.name).copy() for field in fields(self)}

    def rows(self, episodes: Rows) -> Self:
        """The state of some episodes of the batch: ``(k,)`` indices, which may repeat, or a slice, in this order."""
        arrays = (array[episodes] for array in vars(self).values())
        return type(self)(*(_pack(array) if array.dtype == object else array for array in arrays))

    @classmethod
    def join(cls, states: Sequence[Self]) -> Self:
        """The batch of all swarms of some batches."""
        if len(states) == 1:
            return states[0]
        arrays = {field.name: [getattr(state, field.name) for state in states] for field in fields(cls)}
        return cls(**{name: join_rows(parts) for name, parts in arrays.items()})

    def with_rows(self, episodes: NDArray[np.intp], other: SwarmState) -> Self:
        """A copy of this batch in which the episodes of ``other`` replace those at ``episodes``.

        Args:
            episodes: ``(k,)`` indices of different episodes of this batch.
            other: k swarms, with the same N and T_0.
        """
        order = np.arange(len(self.alive))
        order[episodes] = len(order) + np.arange(len(episodes))
        return type(self).join([self, other]).rows(order)  # type: ignore[list-item]  # of the same class

    def episode(self, b: int = 0) -> SwarmState:
        """A copy of episode ``b`` without the leading axis."""
        return SwarmState(**{field.name: np.array(getattr(self, field.name)[b]) for field in fields(self)})


RENAMED = {"bystander": "not_led", "drawn": "initial_heads"}  # attributes by their names in version 0.1.0


def _find_renamed(owner: Any, name: str) -> Any:
    if name not in RENAMED:
        raise AttributeError(f"{type(owner).__name__!r} object has no attribute {name!r}", name=name, obj=owner)
    warnings.warn(f"{name} is now {RENAMED[name]}.", DeprecationWarning, stacklevel=2)
    return getattr(owner, RENAMED[name])


Roles.__getattr__ = SwarmState.__getattr__ = _find_renamed  # type: ignore[attr-defined]


def destroy(state: SwarmState, candidates: Mask) -> SwarmState:
    """Destroy the candidates; followers of a destroyed head join the nearest remaining head (re-merge, paper §II-A).

    ``candidates`` is ``(B, N)`` bool. A follower that copied another follower copies the nearest one above it that is
    left; if none is left up to the head, it joins the nearest remaining head itself.

    >>> from usnet_env.swarm import SwarmConfig, start
    >>> state = start(SwarmConfig(clusters=2, uavs=9), [np.random.default_rng(0)])
    >>> after = destroy(state, state.head)
    >>> after.heads_left, np.unique(after.root[after.alive])  # no head remains
    (array([0]), array([-1]))
    """
    alive = state.alive & ~candidates
    root, source = state.root.copy(), state.source.copy()
    position, velocity = state.past_position.copy(), state.past_velocity.copy()
    kernels.remerge(state.head, alive, state.decoy | state.not_led, state.position, root, source)
    is_lost = state.alive & ~alive
    position.swapaxes(1, 2)[is_lost] = 0.0
    velocity.swapaxes(1, 2)[is_lost] = 0.0
    return replace(state, alive=alive, root=root, source=source, past_position=position, past_velocity=velocity)
