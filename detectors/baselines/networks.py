"""Detectors from scores of all ordered pairs of UAVs: the leader of each UAV, its delay, and the sources."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations
from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field

from detectors.base import Detector
from detectors.parameters import Lags
from detectors.series.designs import check_steps
from detectors.series.votes import find_trees, scatter_to_swarm
from usnet_env.arrays import Floats, Indices, Mask
from usnet_env.detection import Detection, Tags
from usnet_env.series import bound_maximum, centre_columns, correlate_at_lag, reverse_blocks, scale_to_unit
from usnet_env.window import Window

_MOST_BLOCKS = 8
_ROW_MAXIMA = 160  # of the surrogates together; each has one for each UAV
_SURROGATES = (2, 20)  # fewest, most


@dataclass(frozen=True, eq=False)
class Flight:
    """The movement of n living UAVs in T steps."""

    velocity: Floats  #: ``(T, n, 3)`` float64, metres per step; 0 if unseen
    place: Floats  #: ``(T, n, 3)`` float64, metres, the middle of each step; 0 if unseen
    seen: Mask  #: ``(T, n)``


@dataclass(frozen=True, eq=False)
class Pairs:
    """Scores ``(n, n)`` of all ordered pairs; entry (i, j) is about i following j."""

    strength: Floats  #: how closely i follows j; among those that lead i, the strongest is its direct leader
    lead: Floats  #: by how much the evidence that i follows j exceeds that for the reverse; about 0 if neither leads
    delay: Indices | None = None  #: steps after which i follows j, if it is measured
    what: str = "who follow"  #: what followers do after this delay, in words


class NetworkDetector(Detector):
    """Base class of detectors that score all pairs; the heads are UAVs that lead and are led by no UAV.

    A pair is related if the ``strength`` with which i follows j exceeds that of surrogates in which half of the UAVs
    are shifted in time (detectors that compare places leave this out). UAV i follows j if they are related and the
    ``lead``, by how much the evidence exceeds that for the reverse, is higher than that of surrogates in which time is
    reversed, for all UAVs together, in half of up to 8 blocks. Both thresholds control the false discovery rate
    (Benjamini and Hochberg, 1995), by a Gumbel distribution with the mean and variance of the surrogates' row maxima.
    The direct leader of i is the strongest of those that it follows, unless this closes a cycle. A head is the root of
    a tree; a UAV that follows and is followed is a relay.

    Args:
        max_lag: L, the largest delay in samples, at least 1; a quarter of the window at most.
        level: false discovery rate of the followers: the expected share of them that follow no UAV. In a window in
            which no UAV leads, the probability that any is named.
    """

    tags = Tags(most_uavs=10_000, least_steps=5, uses_positions=False)
    _gated: ClassVar[bool] = True  # whether pairs must be related to be compared

    max_lag: Lags = 4
    level: Annotated[float, Field(ge=1e-9, lt=1)] = 0.01

    @abstractmethod
    def pairs(self, flight: Flight, lags: int, needed: Mask | None = None) -> Pairs:
        """Score ordered pairs of n UAVs, at least 2, with delays up to ``lags`` steps.

        Only the pairs ``needed`` ``(n, n)``, symmetric, are read; ``None``: all.
        """

    def detect(self, window: Window) -> Detection:
        """Name the heads of one window; none if no lead exceeds the threshold.

        Returns:
            Candidates (the heads); scores: of a head or a single UAV the sum of its followers' leads above the
            threshold plus its mean lead over others; of a UAV that follows, minus its own lead; clusters (trees; -1: in
            none); leader (the direct one; a head has its own index; -1: none); attention (the lead, clipped at 0); and
            in ``extras``: ``root`` ``(N,)``, the head of each UAV's tree (-1: none), ``relay`` ``(N,)`` bool, ``delay``
            ``(N,)`` steps (-1: unknown), ``threshold``, ``heads``, and ``reasons``, a sentence for each of them.
        """
        check_steps(window, 4)
        lags = max(1, min(self.max_lag, window.observation_steps // 4))
        living = np.flatnonzero(window.alive & window.velocity_seen.any(axis=0))
        if len(living) < 2:
            return _describe(window, living, Pairs(*np.full((2, len(living), len(living)), -np.inf)), np.inf)
        flight = _read_flight(window, living)
        pairs, n = self._measure(flight, lags), len(living)
        count = int(np.clip(math.ceil(_ROW_MAXIMA / n), *_SURROGATES))
        is_related = self._relate(flight, pairs, lags, count) if self._gated else np.isfinite(pairs.strength)
        is_compared = is_related | is_related.T
        rows = is_compared.any(axis=1)
        if not rows.any():
            return _describe(window, living, pairs, np.inf)
        maxima = [
            np.where(is_compared, self._measure(each, lags, is_compared).lead, -np.inf).max(axis=1)[rows]
            for each in reverse_flight(flight, lags, count)
        ]
        lead = np.where(is_related, pairs.lead, -np.inf)
        threshold = _find_threshold(lead[rows].max(axis=1), maxima, self.level)
        return _describe(window, living, replace(pairs, lead=lead), threshold)

    def _relate(self, flight: Flight, pairs: Pairs, lags: int, count: int) -> Mask:
        """Pairs ``(n, n)`` that are closer than in ``count`` / 2 surrogates with half of the UAVs shifted in time."""
        changes = (np.diff(flight.velocity, axis=0) ** 2).sum(axis=(0, 2))
        half = np.argsort(np.argsort(changes, kind="stable")) % 2 == 0  # does not depend on indices
        is_mixed, maxima = half[:, None] != half, list[Floats]()
        for shift in len(flight.velocity) * np.arange(1, count // 2 + 1) // (count // 2 + 1):
            shifted = (
                np.where(half[:, None] if values.ndim == 3 else half, np.roll(values, shift, axis=0), values)
                for values in (flight.velocity, flight.place, flight.seen)
            )
            strength = self._measure(Flight(*shifted), lags, is_mixed).strength
            maxima.append(np.where(is_mixed, strength, -np.inf).max(axis=1))
        return pairs.strength > _find_threshold(pairs.strength.max(axis=1), maxima, self.level)

    def _measure(self, flight: Flight, lags: int, needed: Mask | None = None) -> Pairs:
        pairs = self.pairs(flight, lags, needed)
        np.fill_diagonal(pairs.lead, -np.inf)
        np.fill_diagonal(pairs.strength, -np.inf)
        return pairs


def _read_flight(window: Window, living: Indices) -> Flight:
    seen = window.velocity_seen[:, living]
    position = window.position[:, living].astype(np.float64)
    midpoint = np.where(seen[..., None], (position[1:] + position[:-1]) / 2, 0.0)
    centroid = midpoint.sum(axis=(0, 1)) / max(int(seen.sum()), 1)
    velocity = np.where(seen[..., None], window.velocity[:, living], 0.0).astype(np.float64)
    return Flight(velocity, np.where(seen[..., None], midpoint - centroid, 0.0), seen)


def reverse_flight(flight: Flight, lags: int, count: int) -> Iterator[Flight]:
    """Yield up to ``count`` surrogates in which time is reversed in half of an even number of blocks."""
    steps = len(flight.velocity)
    blocks = 2 * max(1, min(_MOST_BLOCKS // 2, steps // (4 * (lags + 1))))
    choices = [each for each in combinations(range(blocks), blocks // 2) if 0 in each]
    for k in np.unique(np.linspace(0, len(choices) - 1, count).astype(int)):
        order, sign = reverse_blocks(steps, np.isin(np.arange(blocks), choices[k]))
        yield Flight(flight.velocity[order] * sign[:, None, None], flight.place[order], flight.seen[order])


def _find_threshold(values: Floats, maxima: list[Floats], level: float) -> float:
    """The threshold above which at most the share ``level`` of the values are expected to be by chance; or infinity.

    By chance they have the Gumbel distribution with the mean and variance of ``maxima``, those of surrogates.
    """
    bounds = bound_maximum(np.concatenate(maxima), level * np.arange(1, len(values) + 1) / len(values))
    accepted = np.flatnonzero(np.sort(values)[::-1] > bounds)
    return float(bounds[accepted[-1]]) if len(accepted) else math.inf


def correlate_flights(series: Floats, seen: Mask, lags: int) -> tuple[Floats, Indices]:
    """The largest correlation ``(n, n)`` of each UAV with each other's past over the lags 1 to ``lags``, and its lag.

    ``series`` ``(T, n, d)`` counts where it was ``seen`` ``(T, n)``.
    """
    unit = scale_to_unit(centre_columns(series, seen))
    curves = np.stack([correlate_at_lag(unit, unit, lag) for lag in range(1, lags + 1)])
    return curves.max(axis=0), curves.argmax(axis=0) + 1


def _describe(window: Window, living: Indices, pairs: Pairs, threshold: float) -> Detection:
    leader, root = find_trees(pairs.lead, pairs.strength, threshold)
    n, follows = len(living), leader >= 0
    leads = np.bincount(leader[follows], minlength=n) > 0
    heads = np.flatnonzero(leads & ~follows)
    own_lead = np.where(follows, pairs.lead.max(axis=1, initial=-np.inf), 0.0)
    lead = np.where(np.isfinite(pairs.lead), pairs.lead, 0.0)
    excess = np.bincount(root, np.where(follows, own_lead - threshold, 0.0), n)
    scores = np.where(follows, -own_lead, excess + lead.sum(axis=0) / max(n - 1, 1))
    in_tree = follows | leads
    delay = np.full(n, -1)
    if pairs.delay is not None:
        delay[follows] = pairs.delay[np.flatnonzero(follows), leader[follows]]
    scatter = partial(scatter_to_swarm, members=living, uavs=window.uavs)
    return Detection(
        candidates=scatter(leads & ~follows),
        scores=scatter(scores),
        clusters=scatter(np.where(in_tree, np.searchsorted(heads, root), -1), fill=-1),
        leader=scatter(np.where(follows, living[leader], np.where(in_tree, living, -1)), fill=-1),
        attention=scatter(np.maximum(lead, 0.0), pairs=True),
        extras={
            "root": scatter(np.where(in_tree, living[root], -1), fill=-1),
            "relay": scatter(leads & follows),
            "delay": scatter(delay, fill=-1),
            "threshold": threshold,
            "heads": living[heads],
            "reasons": [_explain(int(head), leader, root, delay, window.step, pairs.what) for head in heads],
        },
    )


def _explain(head: int, leader: Indices, root: Indices, delay: Indices, step: float | None, what: str) -> str:
    direct, in_tree = leader == head, (root == head) & (leader >= 0)
    relayed = int((in_tree & ~direct).sum())
    text = f"Leads {int(direct.sum())} directly" + (f" and {relayed} through others" if relayed else "")
    if (known_delays := delay[direct & (delay > 0)]).size:
        steps = float(np.median(known_delays))
        text += f", {what} after {steps * step:g} s" if step is not None else f", {what} after {steps:g} steps"
    return f"{text}; no UAV leads it."
