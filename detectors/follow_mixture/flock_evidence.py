"""What to believe of heads of flocks: a gate of surrogates for each, and how likely every UAV is a head."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from detectors.follow_mixture.explanation import Explanation
from detectors.follow_mixture.flock_heads import LONELY, FlockHeads, Watch, pair_gain
from detectors.follow_mixture.gate import Gate, judged, wrong_times
from detectors.follow_mixture.mixture import head_price
from detectors.follow_mixture.noise import SMOOTH

__all__ = ["explained_by_flocks", "flock_gate", "flock_posterior"]

Floats = NDArray[np.float64]

_TEMPER = 0.7  # rows are not quite independent
_MEMBER = 3.0  # log-odds by which who flies with others at once is less likely a head, where flight is not smooth
_GONE = 3.0  # log-odds that the head of a flock is in the window
_TYPICAL = 0.1  # share of what flocks gain by their heads that a head gives at least
_FAILED = 0.2  # what is left of a head's probability where chance explains as much
_UNKNOWN = 0.45  # the most likely that somebody is a head by the way of flying alone
_A_BIT = 1.0  # nats: a follower that is badly predicted gains little by its head, a head loses by another
_LEAST = 20.0  # nats that a head adds at least
_LEAST_SHARE = 0.05  # of a swarm that follows, in flocks of two and more
_LONE_SHARE = 0.2  # of a swarm that follows, where nobody who follows flies as somebody else does: of n² pairs of
#                    flights a few match by luck


def flock_gate(watch: Watch, found: FlockHeads) -> Gate:
    """Judge every head: its flocks' gain against the same with all heads' pasts moved in time."""
    heads = found.heads
    rows = watch.flight.shape[1]
    count = np.array([np.isin(watch.label, np.flatnonzero(found.head == head)).sum() for head in heads], np.int64)
    followed = found.head >= 0
    observed = _per_head(watch, found, followed, 0)
    surrogates = np.array([_per_head(watch, found, followed, shift) for shift in wrong_times(rows)])
    gate = judged(count, observed - head_price(watch.uavs), surrogates)
    sizes = np.bincount(watch.label, minlength=watch.flocks)
    together = int(sizes[(sizes > 1) & followed].sum())
    enough = together >= _LEAST_SHARE * watch.uavs or followed.sum() >= _LONE_SHARE * watch.uavs
    return replace(gate, passed=gate.passed & (gate.added > _LEAST) & enough)


def _per_head(watch: Watch, found: FlockHeads, followed: NDArray[np.bool_], shift: int) -> Floats:
    """``(M,)`` what the flocks that follow somebody gain by their best head, by head."""
    heads = found.heads
    predicted = None if found.weights is None else found.shown.predicted(found.weights)
    flocks = np.flatnonzero(followed)
    gain = np.array(
        [[pair_gain(watch, found, predicted, int(flock), int(head), shift) for head in heads] for flock in flocks]
    )
    gain = np.maximum(gain, 0.0)
    return np.asarray(np.bincount(gain.argmax(axis=1), weights=gain.max(axis=1), minlength=len(heads)), np.float64)


def flock_posterior(watch: Watch, found: FlockHeads | None, memory: float) -> Floats:
    """``(n,)`` probability of being a head, if every flock of two and more has one, and who flies alone perhaps.

    Args:
        watch: n UAVs in C flocks.
        found: evidence of every flock for every UAV; ``None``: there is none.
        memory: lag-1 autocorrelation of flights. Where it is low a head does not fly at once with its followers.
    """
    sizes = np.bincount(watch.label, minlength=watch.flocks)
    alone = sizes[watch.label] == 1
    prior = np.where(alone, 0.0, -_MEMBER if memory < SMOOTH else 0.0)
    gain = np.zeros((watch.flocks, watch.uavs)) if found is None else found.gain
    logits = _TEMPER * gain + prior
    logits[watch.label[alone], np.flatnonzero(alone)] = -np.inf  # nobody follows itself
    typical = 0.0
    if found is not None and (found.head[sizes > 1] >= 0).any():
        led = np.flatnonzero((sizes > 1) & (found.head >= 0))
        typical = _TYPICAL * float(np.median(found.gain[led, found.head[led]]))
    none = np.where(sizes == 1, LONELY, np.maximum(typical, 0.0) - _GONE)
    nobody = _TEMPER * none + np.log(watch.uavs)
    top = np.maximum(logits.max(axis=1), nobody)
    weight = np.exp(logits - top[:, None])
    share = np.minimum(weight / (weight.sum(axis=1) + np.exp(nobody - top))[:, None], 1.0 - 1e-6)
    several = 1.0 - np.prod(1.0 - share[sizes > 1], axis=0)
    lonely = np.flatnonzero(alone)
    share[watch.label[lonely]] *= (1.0 - several[lonely])[:, None]  # a head follows nobody
    return np.asarray(1.0 - np.prod(1.0 - share, axis=0))


def _left_over(watch: Watch, found: FlockHeads) -> NDArray[np.bool_]:
    """``(n,)`` who flies like nobody else, is no head, and whose flight no other head explains."""
    gain = found.gain[watch.label][:, found.heads].copy()
    gain[found.heads, np.arange(len(found.heads))] = -np.inf
    alone = np.bincount(watch.label, minlength=watch.flocks)[watch.label] == 1
    unlike = alone & (found.head[watch.label] < 0) & (gain.max(axis=1) < -_A_BIT)
    unlike[found.heads] = False
    return unlike


def explained_by_flocks(watch: Watch, found: FlockHeads | None, memory: float) -> Explanation | None:
    """The explanation that flocks and their heads give.

    Args:
        watch: n UAVs in C flocks.
        found: their heads, or ``None`` where nobody's past tells a flock's flight.
        memory: lag-1 autocorrelation of flights.

    Returns:
        ``None`` where nobody flies with anybody and nobody leads.
    """
    unknown = np.minimum(flock_posterior(watch, None, memory), _UNKNOWN)
    if found is None:
        nobody = np.full(watch.uavs, -1, np.int64)
        nothing = np.zeros(watch.uavs)
        if watch.flocks == watch.uavs:
            return None
        return Explanation(np.empty(0, np.int64), nobody, unknown, unknown, nothing, nothing)
    gate = flock_gate(watch, found)
    heads = found.heads
    leader = found.head[watch.label]
    leader[heads] = -1
    sizes = np.bincount(watch.label, minlength=watch.flocks)
    nats = np.where(found.head >= 0, found.gain[np.arange(watch.flocks), np.maximum(found.head, 0)], 0.0)
    follows = leader >= 0
    share = 1.0 - np.exp(-np.maximum(nats, 0.0) / (1.5 * watch.freedom))
    given = flock_posterior(watch, found, memory)
    probability = given.copy()
    probability[heads] *= np.where(gate.passed, 1.0, _FAILED)
    trust = float(gate.added[gate.passed].sum()) / max(float(np.maximum(gate.added, 0.0).sum()), 1e-9)
    if trust < 0.5:  # evidence that chance matches says nothing of others either
        probability = np.maximum(probability * trust, unknown)
        if memory < SMOOTH:  # who flies alone is told by more than chance
            given = np.maximum(given, unknown)
    return Explanation(
        heads=heads,
        leader=leader,
        probability=probability,
        given=given,
        gain=np.where(follows, (nats / sizes)[watch.label], 0.0),
        explained=np.where(follows, share[watch.label], 0.0),
        reasons=gate.reasons(),
        strategy={
            "class": found.shown.library.name,
            "shared": found.weights is not None,
            "weights": found.weights,
            "flocks": watch.label,
        },
        value=found.value,
        passed=gate.passed,
        left=_left_over(watch, found),
    )
