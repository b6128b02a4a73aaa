"""Tests the heads of flocks against surrogates, and computes each UAV's posterior probability of being a head."""

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

_TEMPER = 0.7  # tempering, since rows are not independent
_MEMBER = 3.0  # log-odds by which a member of a flock is less likely a head, if motion is not smooth
_GONE = 3.0  # log-odds that the head of a flock is in the window
_TYPICAL = 0.1  # least gain of a flock by a head, as a share of the median over flocks
_FAILED = 0.2  # factor on the probability of a head that fails its test
_UNKNOWN = 0.45  # largest probability of being a head if no leader is identified
_A_BIT = 1.0  # nats: a poorly predicted follower gains little by its head; a head loses more than this by another head
_LEAST = 20.0  # least contribution of a head, in nats
_LEAST_SHARE = 0.05  # least share of the swarm that follows, in flocks of two and more UAVs
_LONE_SHARE = 0.2  # least share of the swarm that follows, if no followers form a flock: a few of n² pairs match by
#                    chance


def flock_gate(watch: Watch, found: FlockHeads) -> Gate:
    """Test each head: the gain of its flocks against the gain with the pasts of all heads shifted in time."""
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
    """``(M,)``: the summed gain of the assigned flocks by their best head, per head."""
    heads = found.heads
    predicted = None if found.weights is None else found.shown.predicted(found.weights)
    flocks = np.flatnonzero(followed)
    gain = np.array(
        [[pair_gain(watch, found, predicted, int(flock), int(head), shift) for head in heads] for flock in flocks]
    )
    gain = np.maximum(gain, 0.0)
    return np.asarray(np.bincount(gain.argmax(axis=1), weights=gain.max(axis=1), minlength=len(heads)), np.float64)


def flock_posterior(watch: Watch, found: FlockHeads | None, memory: float) -> Floats:
    """``(n,)``: probability of being a head, if each flock of several UAVs has a head and a single UAV may have one.

    Args:
        watch: n UAVs in C flocks.
        found: the evidence of each flock for each UAV; ``None``: no evidence.
        memory: lag-1 autocorrelation of the velocities. If it is low, a head is not correlated with its followers at
            lag 0.
    """
    sizes = np.bincount(watch.label, minlength=watch.flocks)
    alone = sizes[watch.label] == 1
    prior = np.where(alone, 0.0, -_MEMBER if memory < SMOOTH else 0.0)
    gain = np.zeros((watch.flocks, watch.uavs)) if found is None else found.gain
    logits = _TEMPER * gain + prior
    logits[watch.label[alone], np.flatnonzero(alone)] = -np.inf  # no UAV follows itself
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
    share[watch.label[lonely]] *= (1.0 - several[lonely])[:, None]  # a head follows no UAV
    return np.asarray(1.0 - np.prod(1.0 - share, axis=0))


def _left_over(watch: Watch, found: FlockHeads) -> NDArray[np.bool_]:
    """``(n,)``: which UAVs are in no flock, are no heads, and are not predicted by any head."""
    gain = found.gain[watch.label][:, found.heads].copy()
    gain[found.heads, np.arange(len(found.heads))] = -np.inf
    alone = np.bincount(watch.label, minlength=watch.flocks)[watch.label] == 1
    unlike = alone & (found.head[watch.label] < 0) & (gain.max(axis=1) < -_A_BIT)
    unlike[found.heads] = False
    return unlike


def explained_by_flocks(watch: Watch, found: FlockHeads | None, memory: float) -> Explanation | None:
    """Convert flocks and their heads to the common result.

    Args:
        watch: n UAVs in C flocks.
        found: their heads; ``None`` if no UAV's past predicts a flock.
        memory: lag-1 autocorrelation of the velocities.

    Returns:
        ``None`` if there are neither flocks nor heads.
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
    if trust < 0.5:  # if chance explains as much, the evidence is not reliable for other UAVs either
        probability = np.maximum(probability * trust, unknown)
        if memory < SMOOTH:  # single UAVs are candidates for other reasons than chance
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
