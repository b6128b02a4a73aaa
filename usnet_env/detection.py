"""The detection: a detector's answer to one window."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from usnet_env.arrays import Floats, Indices, Mask
from usnet_env.config import ArgumentError, list_names, named_values, quote
from usnet_env.window import Window, frozen_array

_ROUNDING = 1e-6  # probabilities in single precision may exceed 1 by so much


@dataclass(frozen=True)
class Tags:
    """What a detector needs and uses.

    Args:
        needs: the packages that it needs beyond an installation of USNET without extras, such as ``("torch",)``.
        most_uavs: the largest number of UAVs in a window; ``None`` for no limit.
        least_steps: the smallest number of velocities T_ob in a window, with the default arguments.
        uses_positions: whether an answer depends on positions where no sample is missing.
        takes_clusters: whether an argument gives the number of clusters M.
        needs_unit_speed: whether answers depend on the unit of length, because the detector was made for UAVs that fly
            about 1 m per step. Windows of recorded tracks are scaled for such detectors.
        false_leaders: whether more than 5 % of the windows of tracks without a leader have a confirmed one;
            ``usnet detect`` takes such a detector only with ``--unconfirmed``.
    """

    needs: tuple[str, ...] = ()
    most_uavs: int | None = None
    least_steps: int = 1
    uses_positions: bool = True
    takes_clusters: bool = False
    needs_unit_speed: bool = False
    false_leaders: bool = False


@dataclass(frozen=True, eq=False)
class Detection:
    """The answer of a detector to one window of N UAVs. All arrays are read-only copies.

    Args:
        candidates: ``(N,)`` bool, the UAVs to destroy in this round (the paper's Ĥ_r).
        scores: ``(N,)`` float64, finite; a higher score means a more likely head.
        clusters: ``(N,)`` int64, a cluster label for each UAV (-1: no cluster), or ``None``.
        leader: ``(N,)`` int64, the UAV that each UAV follows, its head or a relay (-1: none), or ``None``. A head has
            its own index or -1; if it is a candidate, any other index is read as its own.
        attention: ``(N, N)`` float64; row i has the attention weights of UAV i on all UAVs, or ``None``.
        extras: further results by name; ``"probability"``, ``(N,)`` from 0 to 1, is that of being a head,
            and ``"p_no_leader"`` the one that no UAV leads.

    Raises:
        ArgumentError: an array has another shape, values that are not finite, or indices or probabilities out of range.

    >>> detection = Detection(candidates=[True, False, False], scores=[0.9, 0.1, 0.2], leader=[-1, 0, 0])
    >>> detection.candidates.nonzero()[0].tolist()
    [0]
    """

    candidates: Mask
    scores: Floats
    clusters: Indices | None = None
    leader: Indices | None = None
    attention: Floats | None = None
    extras: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        set_field = object.__setattr__
        set_field(self, "candidates", frozen_array("candidates", self.candidates, bool, (None,)))
        uavs = len(self.candidates)
        set_field(self, "scores", frozen_array("scores", self.scores, np.float64, (uavs,)))
        for name, kind, axes in (("clusters", np.int64, 1), ("leader", np.int64, 1), ("attention", np.float64, 2)):
            if (value := getattr(self, name)) is not None:
                set_field(self, name, frozen_array(name, value, kind, (uavs,) * axes))
        if self.leader is not None and not ((self.leader >= -1) & (self.leader < uavs)).all():
            raise ArgumentError(f"leader must hold indices from -1 to {uavs - 1}, got {quote(self.leader)}.")
        set_field(self, "extras", named_values("extras", self.extras))
        if (value := self.extras.get("probability")) is not None:
            probability = frozen_array("probability", value, np.float64, (uavs,))
            if not ((probability >= -_ROUNDING) & (probability <= 1 + _ROUNDING)).all():
                raise ArgumentError(f"probability must hold numbers from 0 to 1, got {quote(probability)}.")

    def after(self, removed: ArrayLike, window: Window) -> Indices:
        """The candidate that each UAV follows once some UAVs are removed, ``(N,)``; -1 if none is left.

        It goes by the links of the detection and by the rule of the game: followers of a removed relay go on with the
        next one above, and followers of a removed candidate, or of none, join the nearest one that is left, with all
        below. Nearest is by the last positions that are seen. Without ``leader``, UAVs follow the candidate of
        their cluster.

        Args:
            removed: ``(N,)`` bool.
            window: the one that was answered.

        Raises:
            ArgumentError: ``removed`` has another shape, or values other than 0 and 1.
        """
        indices = np.arange(len(self.candidates))
        is_left = ~frozen_array("removed", removed, bool, (len(indices),)) & window.alive
        heads = np.flatnonzero(self.candidates & is_left)
        if not len(heads):
            return np.full(len(indices), -1)
        last = len(window.seen) - 1 - window.seen[::-1].argmax(axis=0)
        position = window.position[last, indices].astype(np.float64)
        nearest = heads[np.linalg.norm(position[:, None] - position[heads], axis=2).argmin(axis=1)]
        leader = self.list_leaders()
        for _ in range(len(indices).bit_length()):  # past removed relays; each pass doubles the length of the chains
            leader = np.where(is_left[leader] | self.candidates[leader], leader, leader[leader])
        leader = np.where(is_left[leader] & (leader != indices), leader, nearest)
        leader[heads] = heads
        for _ in range(len(indices).bit_length()):
            leader = leader[leader]
        return np.where(is_left, np.where(self.candidates[leader] & is_left[leader], leader, nearest), -1)

    def list_leaders(self) -> Indices:
        """``(N,)`` the one that each UAV follows, without ``leader`` the candidate of its cluster.

        It is the UAV itself if it is a candidate or follows none.
        """
        indices, leader = np.arange(len(self.candidates)), self.leader
        if leader is None and self.clusters is not None:
            leader = np.full(len(indices), -1)
            for head in np.flatnonzero(self.candidates & (self.clusters >= 0)):
                leader[self.clusters == self.clusters[head]] = head
        return indices if leader is None else np.where(self.candidates | (leader < 0), indices, leader)

    def __repr__(self) -> str:
        candidates = np.flatnonzero(self.candidates)
        names = list_names(candidates, 6, ", …") or "none"
        return f"<Detection for {len(self.candidates)} UAVs, {len(candidates)} named: {names}>"


def read_tags(detector: Any) -> Tags:
    """The tags of a detector or of its class; the default ones if it declares none."""
    tags = getattr(detector, "tags", None)
    return tags if isinstance(tags, Tags) else Tags()


def fit_window(detector: Any, window: Window) -> Window:
    """The window as a detector receives it: scaled if it is of recorded tracks and the detector needs unit speed.

    In the unit of length of the scaled window, the root mean square of all seen velocities is 1 per step. Any other
    window is returned as it is.
    """
    if window.step is None or not read_tags(detector).needs_unit_speed:
        return window
    seen = window.velocity_seen
    speed = float(np.sqrt((window.velocity[seen].astype(np.float64) ** 2).sum(axis=-1).mean())) if seen.any() else 0.0
    unit = speed or 1.0
    return replace(window, position=window.position / unit, velocity=window.velocity / unit)


def ask(detector: Any, window: Window) -> tuple[Detection, float]:
    """The answer of a detector to a window, which it gets as of :func:`fit_window`, and the seconds that it took.

    Raises:
        ArgumentError: the answer is no detection for all UAVs of the window.
    """
    window = fit_window(detector, window)
    begin = time.perf_counter()
    answer = detector.detect(window)
    seconds = time.perf_counter() - begin
    if not isinstance(answer, Detection) or len(answer.candidates) != window.uavs:
        expected = f"a usnet_env.Detection for all {window.uavs} UAVs"
        raise ArgumentError(f"detect must return {expected}, got {quote(answer)}.")
    return answer, seconds
