"""Converts a mixture to the common result: tests its heads, puts UAVs into categories, describes the strategy."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from detectors.follow_mixture.explanation import KINDS, Explanation
from detectors.follow_mixture.facility import LEAST_VOTERS
from detectors.follow_mixture.gate import Gate, gate_heads
from detectors.follow_mixture.history import OwnHistory
from detectors.follow_mixture.mixture import Mixture
from detectors.follow_mixture.samples import Samples
from detectors.follow_mixture.search import MISFIT, misfit
from detectors.follow_mixture.strategy import directions

__all__ = ["explained_by_mixture"]

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]

_LOST = 0.5  # share of its gain that a follower may lose under another head that could be its own
_MOMENTS_A_NUMBER = 2  # least number of samples of all heads together per parameter and axis


def explained_by_mixture(samples: Samples, history: OwnHistory, mixture: Mixture | None) -> Explanation | None:
    """Convert a mixture to the common result."""
    if mixture is None or not len(mixture.heads.heads):
        return None
    gate = gate_heads(samples, history, mixture)
    leader = mixture.heads.leader
    followers = np.flatnonzero(leader >= 0)
    predicted = directions(samples, mixture.strategy, followers, leader[followers])
    holds = misfit(samples, mixture.strategy, leader, predicted).worst <= MISFIT
    place = np.minimum(np.searchsorted(mixture.columns, np.maximum(leader, 0)), len(mixture.columns) - 1)
    return Explanation(
        heads=mixture.heads.heads,
        leader=leader,
        probability=np.zeros(samples.uavs),
        given=np.zeros(samples.uavs),
        gain=np.where(leader >= 0, mixture.gain[np.arange(samples.uavs), place], 0.0),
        explained=_explained(samples, history, followers, *predicted),
        reasons=gate.reasons(),
        strategy=_described(mixture, samples),
        value=mixture.value,
        kind=_kinds(mixture, gate, holds, _tested(samples, mixture)),
        passed=gate.passed,
    )


def _tested(samples: Samples, mixture: Mixture) -> bool:
    """Whether there are enough samples of the heads to rule out that the strategy fits any motion."""
    return len(mixture.heads.heads) * samples.rows >= _MOMENTS_A_NUMBER * len(mixture.strategy.coefficients)


def _kinds(mixture: Mixture, gate: Gate, holds: bool, tested: bool) -> Indices:
    """``(n,)``: indices in :data:`KINDS`, by whether the strategy fits and whether the fit is conclusive."""
    left = mixture.heads.leader < 0
    left[mixture.heads.heads] = False
    kind = np.where(left, KINDS.index("alone" if holds and tested else "missing"), KINDS.index("follower"))
    if tested and not holds and left.sum() <= LEAST_VOTERS:
        # The followers of a missed head are unassigned too.
        kind[left & ~could_lead(mixture)] = KINDS.index("stray")
    kind[mixture.heads.heads] = np.where(gate.passed, KINDS.index("passed"), KINDS.index("failed"))
    return kind


def could_lead(mixture: Mixture) -> NDArray[np.bool_]:
    """``(n,)``: which UAVs could lead two followers of other heads without a large loss of their gains.

    True for UAVs that were no candidates, whose gains are unknown.
    """
    could = np.ones(len(mixture.heads.leader), bool)
    followers = np.flatnonzero(mixture.heads.leader >= 0)
    if len(followers) < LEAST_VOTERS:
        return could
    own = mixture.gain[followers, np.searchsorted(mixture.columns, mixture.heads.leader[followers])]
    share = mixture.gain[followers] / np.maximum(own, 1e-9)[:, None]
    could[mixture.columns] = np.partition(share, -LEAST_VOTERS, axis=0)[-LEAST_VOTERS] > -_LOST
    return could


def _explained(samples: Samples, history: OwnHistory, followers: Indices, predicted: Floats, valid: Mask) -> Floats:
    """``(n,)``: share of each follower's innovation that its head explains; 0 for other UAVs."""
    share = np.zeros(samples.uavs)
    if samples.unit:
        predicted = predicted / np.maximum(np.sqrt((predicted**2).sum(axis=2, keepdims=True)), 1e-12)
    keep = (valid & samples.seen[followers])[..., None]
    left = ((samples.target[followers] - predicted) ** 2 * keep).sum(axis=(1, 2))
    whole = (history.surprise[followers] ** 2 * keep).sum(axis=(1, 2))
    share[followers] = np.clip(1.0 - left / np.maximum(whole, 1e-12), 0.0, 1.0)
    return share


def _lag_profile(mixture: Mixture) -> Floats:
    """``(L,)``: share of each lag in the squared weights of the head's velocities and their functions."""
    library = mixture.strategy.library
    groups = int(library.linear) + int(library.squares) + int(library.products)
    weights = mixture.strategy.coefficients[-1 - 3 * library.lags * groups : -1]
    power = (weights**2).reshape(groups, library.lags, 9).sum(axis=(0, 2))
    return np.asarray(power / max(float(power.sum()), 1e-12))


def _described(mixture: Mixture, samples: Samples) -> dict[str, Any]:
    """A readable description of the strategy."""
    strategy = mixture.strategy
    library = strategy.library
    return {
        "lag_profile": _lag_profile(mixture),
        "class": library.name,
        "shared": True,
        "coefficients": strategy.coefficients,
        "spread": strategy.noise.spread,
        "floor": strategy.noise.floor,
        "parameters": strategy.parameters,
        "unit_speed": samples.unit,
    }
