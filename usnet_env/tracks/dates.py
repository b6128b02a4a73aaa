"""When a group changes its leader, and whether it follows one, by how well the past of a leader explains its motion.

The velocity of a follower is a weighted sum of its last two and of two successive ones of its leader some steps before;
that of a free id, of its last two alone. What remains is about independent from step to step. The cost of a part of the
time is the negative logarithm of its likelihood, in nats, with the lag and the weights that fit best there.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from usnet_env.arrays import Floats, Indices, Mask
from usnet_env.tracks.links import cut_positions
from usnet_env.tracks.tracks import Tracks

NO_LEADER = -1
_MAX_LAG, _OWN = 12, 2  # steps; velocities of its own past
_LEAST, _MOST = 12, 160  # steps that a fit takes; steps from a guess
_MOST_MEMBERS = 20  # of a group that are compared
_WEIGHTS = 5  # of a follower, with its lag
_OWN_DATE = 12.0  # nats that a date of its own must gain for a group
_TAIL = 0.025  # of the probability on each side of an interval
_ROUNDING = 1e-9  # of a sum of squares

Span = tuple[float, float]  # seconds


class Dates(NamedTuple):
    """The cost ``(C,)`` of a change at each of C instants from the ``first`` one on."""

    first: int
    cost: Floats


class _Sums(NamedTuple):
    """Sums of products, up to each of T instants, of the velocity of an id, its past, and that of a leader."""

    products: Floats  # (T, K, P, P): at K lags
    numbers: Floats  # (T,): how many were added

    def part(self, start: Indices | int, end: Indices | int) -> _Sums:
        return _Sums(self.products[end] - self.products[start], self.numbers[end] - self.numbers[start])


def weigh_dates(tracks: Tracks, rows: Indices, old: int, new: int, between: tuple[float, float, float]) -> Dates:
    """The cost of a change from leader ``old`` to ``new``, -1: none, for the members of a group with these rows.

    A leader itself is free. Only members count whose motion changes, so that a change explains it better than one
    leader all the time: if the leader of a group begins to follow another, its followers copy it as before. If no
    member is such, all count. ``between`` are seconds: the earliest time, a guess, and the latest.
    """
    step = float(tracks.step or 1.0)
    low, guess, high = (round(time / step) for time in between)
    low, high = max(low, guess - _MOST, 1), min(max(high, low + 1), guess + _MOST)
    start, end = max(low - _LEAST, 0), high + _LEAST
    cuts = np.arange(low, high + 1) - start
    costs, gains = [np.zeros(len(cuts))], [-np.inf]
    for before, after in _sum_motions(tracks, rows, (old, new), start, end):
        cost = _weigh(before.part(0, cuts)) + _weigh(after.part(cuts, -1))
        constant = min(float(_weigh(sums.part(0, -1))) for sums in (before, after))
        costs.append(cost)
        gains.append(constant - cost.min() - _WEIGHTS / 2 * np.log(max(before.numbers[-1], 1.0)))
    changed = np.array(gains) > 0
    return Dates(low, np.sum(costs, axis=0, where=(changed | ~changed.any())[:, None]))


def explain_motion(
    tracks: Tracks, rows: Indices, leader: int, spans: Sequence[Span], known: Sequence[Span] = ()
) -> Floats:
    """Nats by which the past of a leader explains the motion of a group better than its own, in each span; ``(S,)``.

    The lag, the weights and the variance of what remains are those that fit best in the ``known`` spans, or else in all
    ``spans``, less what it costs to choose them.
    """
    step, gain = float(tracks.step or 1.0), np.zeros(len(spans))
    instants = np.round(np.array([*spans, *known]) / step).astype(int)
    start, end = max(int(instants.min()), 0), int(instants.max())
    instants = (instants - start).clip(0, end - start)
    here, there = instants[: len(spans)].T, instants[len(spans) if known else 0 :].T
    for free, led in _sum_motions(tracks, rows, (NO_LEADER, leader), start, end):
        part, whole = led.part(*here), led.part(*there)
        if not whole.numbers.any():
            continue
        weights, left = _fit(whole.products.sum(axis=0))
        best, numbers = int(left.argmin()), part.numbers
        least = _ROUNDING * led.products[-1, 0, 0, 0] + 1e-300
        variance = max(float(left[best]), least) / whole.numbers.sum()
        terms = np.append(1.0, -weights[best])
        made = np.einsum("p,spq,q->s", terms, part.products[:, best], terms)
        gain += _weigh(free.part(*here)) - (numbers * np.log(variance) + made / variance - numbers) / 2
        gain -= 0.0 if known else (_WEIGHTS - _OWN) / 2 * np.log(np.maximum(numbers, 1.0))
    return gain


def join_dates(changes: Sequence[Dates]) -> list[Dates]:
    """Changes, each with the sum of the costs of all that are one: a date of its own doesn't gain a group enough."""
    joined = sorted((change.first + int(change.cost.argmin()), k, [k], change) for k, change in enumerate(changes))
    while len(joined) > 1:
        pairs = [_add_dates(first[3], second[3]) for first, second in pairwise(joined)]
        best = min(range(len(pairs)), key=lambda k: pairs[k][0])
        if pairs[best][0] > _OWN_DATE:
            break
        change = pairs[best][1]
        members = joined[best][2] + joined[best + 1][2]
        joined[best : best + 2] = [(change.first + int(change.cost.argmin()), members[0], members, change)]
    of = {k: change for _, _, members, change in joined for k in members}
    return [of[k] for k in range(len(changes))]


def _add_dates(one: Dates, other: Dates) -> tuple[float, Dates]:
    """What it costs that two changes are one, and that one."""
    first = max(one.first, other.first)
    last = min(one.first + len(one.cost), other.first + len(other.cost))
    if last <= first:
        return np.inf, one
    cost = sum(each.cost[first - each.first : last - each.first] for each in (one, other))
    return float(np.min(cost) - one.cost.min() - other.cost.min()), Dates(first, np.asarray(cost))


def read_date(dates: Dates, step: float) -> tuple[float, float, float]:
    """The second of a change, and its 95 % interval."""
    likelihood = np.exp(dates.cost.min() - dates.cost)
    cumulative = np.cumsum(likelihood) / likelihood.sum()
    best, low, high = (int(k) for k in (dates.cost.argmin(), *np.searchsorted(cumulative, [_TAIL, 1 - _TAIL])))
    time, start, end = (
        round(float((dates.first + k) * step), 9) for k in (best, min(low, best - 1), max(high, best + 1))
    )
    return time, start, end


def _sum_motions(
    tracks: Tracks, rows: Indices, leaders: tuple[int, int], start: int, end: int
) -> Iterator[tuple[_Sums, _Sums]]:
    """Of each member that some leader but itself may lead: sums with both leaders; without one for itself, and -1."""
    step = float(tracks.step or 1.0)
    begin = max(start - _MAX_LAG - _OWN, 0)
    members = [*np.intersect1d(rows, leaders), *np.setdiff1d(rows, leaders)[:_MOST_MEMBERS]]
    columns = np.array([*members, *leaders])
    position, seen = cut_positions(tracks, columns, begin * step, end * step)
    velocity = np.diff(position, axis=0)
    known = np.asarray(sliding_window_view(np.vstack([seen[:1]] * _OWN + [seen]), _OWN + 2, axis=0).all(axis=2))
    known[: start - begin] = False
    for k, member in enumerate(members):
        pairs = zip(leaders, (velocity[:, -2], velocity[:, -1]), strict=True)
        heads = [None if leader in (NO_LEADER, member) else past for leader, past in pairs]
        if any(head is not None for head in heads):
            first, second = (_sum_products(velocity[:, k], head, known[:, k], start - begin) for head in heads)
            yield first, second


def _sum_products(own: Floats, head: Floats | None, known: Mask, start: int) -> _Sums:
    """The sums for a velocity ``(T, d)``, and that of its leader, from instant ``start`` on."""
    times = np.arange(start, len(own))
    terms = [own[np.maximum(times - k, 0)][None] for k in range(_OWN + 1)]
    if head is not None:
        lags = np.arange(_MAX_LAG + 1)[:, None]
        past = [head[np.maximum(times - lags - k, 0)] for k in range(2)]
        terms = [np.broadcast_to(term, past[0].shape) for term in terms] + past
    rows = np.stack(terms, axis=3) * known[start:, None, None]  # (K, T, d, P)
    products = np.cumsum(np.einsum("ktdp,ktdq->tkpq", rows, rows, optimize=True), axis=0)
    count = np.cumsum(known[start:]) * own.shape[1]
    return _Sums(np.concatenate([0 * products[:1], products]), np.append(0.0, count))


def _weigh(sums: _Sums) -> Floats:
    """The cost of the lag and weights that fit best."""
    left, count = _fit(sums.products)[1].min(axis=-1), np.asarray(sums.numbers)
    return np.asarray(count / 2 * np.log(np.maximum(left, 1e-300) / np.maximum(count, 1.0)))


def _fit(products: Floats) -> tuple[Floats, Floats]:
    """The weights ``(…, K, P - 1)`` by least squares, and what they leave of the sum of squares ``(…, K)``."""
    square, cross, gram = products[..., 0, 0], products[..., 0, 1:], products[..., 1:, 1:]
    ridge = _ROUNDING * np.trace(gram, axis1=-2, axis2=-1) + 1e-300
    gram = gram + ridge[..., None, None] * np.eye(gram.shape[-1])
    weights = np.linalg.solve(gram, cross[..., None])[..., 0]
    return weights, np.maximum(square - (weights * cross).sum(axis=-1), _ROUNDING * square)
