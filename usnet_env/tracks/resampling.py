"""Put tracks on one grid of times: choose the step, and fit or interpolate the positions at the grid's times."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from usnet_env.arrays import Floats, Indices
from usnet_env.config import ArgumentError, quote
from usnet_env.tracks.findings import typical_intervals

if TYPE_CHECKING:
    from usnet_env.tracks.tracks import Tracks

__all__ = ["StepChoice", "choose_step", "resample_positions"]

_LEAST_FIT = 3  # samples within a grid step from which a straight line is fitted
_SNAP = 1e-6  # grid steps; times that differ by less are the same
_TYPICAL_SHARE, _BRIDGE = 0.9, 1.5  # intervals up to 1.5 times that of this quantile are interpolated
_MOST_GRID = 10**8  # samples of the result

# The choice of the step looks at a part of the tracks: followers, neighbours of each, ids in all, and samples.
_FOCAL, _NEIGHBOURS, _POOL, _PART = 48, 24, 400, 2048
_LARGEST_LAG, _LARGEST_SCALE = 64, 16  # samples
_BEST_LAG, _WORST_LAG = 2, 4  # steps; the best lag should lie at about 2, and may lie at 1 to 4
_SIGNAL = 4.0  # in a step, the squared movement should exceed the noise of the squared movement this many times
_SIGNIFICANT = 5.0  # a peak of the correlation exceeds the other lags' by this many robust standard deviations
_FEWEST_PAIRS = 3


class _Grid(NamedTuple):
    """Resampled tracks: offsets ``(N + 1,)``, time ``(G,)``, position ``(G, 3)`` and leader ``(G,)`` or ``None``."""

    offsets: Indices
    time: Floats
    position: Floats
    leader: Indices | None


def resample_positions(tracks: Tracks, step: float, max_gap: float | None) -> _Grid:
    """Resample all tracks to the times 0, ``step``, 2 ``step``, ...; see :meth:`Tracks.resample`.

    Raises:
        ArgumentError: the step is so short that the result has more than 10⁸ samples, or no id has two samples.
    """
    first, last = tracks.offsets[:-1], tracks.offsets[1:]
    filled = last - first > 1
    if not filled.any():
        raise ArgumentError("tracks must hold an id with at least 2 samples; each id has only one.")
    counts = np.zeros(len(tracks.ids), np.int64)
    for i in np.flatnonzero(filled):
        counts[i] = int(_grid_numbers(tracks.time[first[i] : last[i]] / step, step, max_gap)[1].sum())
    total = int(counts.sum())
    if total > _MOST_GRID:
        raise ArgumentError(
            f"step must be at least {step * total / _MOST_GRID:.3g} s, or the result has more than {_MOST_GRID:g} "
            f"samples, got {quote(step)}."
        )
    times, places, leaders, end = np.empty(total), np.empty((total, 3)), [], 0
    for i in np.flatnonzero(filled):
        part = slice(int(first[i]), int(last[i]))
        number, place, nearest = _resample_one(tracks.time[part], tracks.position[part], step, max_gap)
        begin, end = end, end + len(number)
        times[begin:end], places[begin:end] = number * step, place
        if tracks.leader is not None:
            leaders.append(tracks.leader[part][nearest])
    for array in (times, places):
        array.setflags(write=False)
    return _Grid(
        np.concatenate([[0], np.cumsum(counts)]),
        times,
        places,
        np.concatenate(leaders) if leaders else None,
    )


def _resample_one(
    time: Floats, position: Floats, step: float, max_gap: float | None
) -> tuple[Indices, Floats, NDArray[np.intp]]:
    """Resample one track ``(S,)``, ``(S, 3)``.

    Returns:
        ``(G,)`` numbers of the grid times, ``(G, 3)`` positions, and ``(G,)`` index of the nearest sample.
    """
    at = time / step
    low, count = _grid_numbers(at, step, max_gap)
    number = np.repeat(low - np.cumsum(count) + count, count) + np.arange(int(count.sum()))
    after = np.clip(np.searchsorted(at, number - _SNAP), 1, len(at) - 1)
    before = after - 1
    length = at[after] - at[before]
    share = np.clip((number - at[before]) / length, 0.0, 1.0)
    hit = np.minimum(share, 1 - share) * length <= _SNAP  # a sample lies at the grid time
    share = np.where(hit, np.round(share), share)
    place = position[before] + share[:, None] * (position[after] - position[before])
    nearest = np.where(share < 0.5, before, after)
    if len(number) and np.median(np.diff(at)) <= 1 / 2:
        _fit_lines(at, position, number, place)
    return number, place, nearest


def _grid_numbers(at: Floats, step: float, max_gap: float | None) -> tuple[Indices, Indices]:
    """The grid times at which a track has samples, for sample times ``at`` ``(S,)`` in steps.

    Returns:
        ``(S,)`` number of the first grid time from each sample on, and ``(S,)`` how many grid times there are from it
        and before the next sample: all of them if the next sample is close enough, otherwise only the sample's own.
    """
    interval = np.diff(at)
    usual = max(_BRIDGE * float(np.quantile(interval, _TYPICAL_SHARE)), 1.0)
    longest = usual if max_gap is None else max_gap / step
    low = np.ceil(at - _SNAP).astype(np.int64)
    count = (low - at <= _SNAP).astype(np.int64)
    bridged = interval <= longest * (1 + _SNAP)
    count[:-1] = np.where(bridged, np.diff(low), count[:-1])
    return low, count


def _fit_lines(at: Floats, position: Floats, number: Indices, place: Floats) -> None:
    """Replace ``place`` ``(G, 3)`` by straight lines fitted within half a step, where there are enough samples."""
    cell = np.floor(at + 0.5).astype(np.int64)
    starts = np.flatnonzero(np.diff(cell, prepend=cell[0] - 1))
    numbers = cell[starts]
    base = np.repeat(position[starts], np.diff(np.append(starts, len(at))), axis=0)
    u, p = at - cell, position - base
    count = np.diff(np.append(starts, len(at))).astype(np.float64)
    sum_u, sum_uu = np.add.reduceat(u, starts), np.add.reduceat(u * u, starts)
    sum_p, sum_up = np.add.reduceat(p, starts, axis=0), np.add.reduceat(u[:, None] * p, starts, axis=0)
    spread = count * sum_uu - sum_u**2
    encloses = (np.minimum.reduceat(u, starts) <= 0) & (np.maximum.reduceat(u, starts) >= 0)
    good = (count >= _LEAST_FIT) & encloses & (spread > 1e-4 * count**2)
    line = (sum_uu[:, None] * sum_p - sum_u[:, None] * sum_up) / np.where(good, spread, 1.0)[:, None]
    where = np.minimum(np.searchsorted(numbers, number), len(numbers) - 1)
    fitted = (numbers[where] == number) & good[where]
    place[fitted] = (position[starts] + line)[where[fitted]]


@dataclass(frozen=True)
class StepChoice:
    """A step and the reasons for it.

    Args:
        step: seconds.
        reasons: a sentence each.
        noise: standard deviation of the positions' noise per axis, metres.
        lag: seconds after which an id follows a neighbour, the median over the pairs; ``None``: no pair follows.
    """

    step: float
    reasons: tuple[str, ...]
    noise: float
    lag: float | None


def choose_step(tracks: Tracks) -> StepChoice:
    """Choose the step of the grid.

    The noise of the positions is white, so it adds -σ² to the covariance of successive steps and nothing to later ones:
    σ² = 2 c₂ - c₃ - c₁ (at least 0), with the covariances c_k of steps k apart, because those of the movement itself
    change slowly. The step is long enough that the mean squared movement is at least four times its noise. Then
    the lag of each pair of neighbours is the peak of the cross-correlation of their velocities; the step is half the
    median of the lags that are significant and not 0, so that an id follows after about 2 steps.

    Raises:
        ArgumentError: no id has two samples.
    """
    typical = typical_intervals(tracks)
    if not np.isfinite(typical).any():
        raise ArgumentError("tracks must hold an id with at least 2 samples; each id has only one.")
    interval = float(np.nanmedian(typical))
    velocity = _sample_velocities(tracks, interval)
    noise, needed = _noise(velocity)
    lag, edge, pairs = _lag(velocity, needed)
    factor = float(needed)
    reasons = []
    if needed > 1:
        reasons.append(
            f"the noise of the positions is about {noise:.2g} m, and the movement exceeds it twice in "
            f"{needed * interval:g} s"
        )
    elif noise:
        reasons.append(f"the noise of the positions is about {noise:.2g} m, less than half of the movement in a step")
    if lag is None:
        reasons.append("no id follows a neighbour with a significant delay, so delays have no part in the choice")
    else:
        follows = f"an id follows its neighbours after {lag * interval:g} s (median of {pairs} pairs)"
        if lag > _WORST_LAG:
            factor = max(factor, float(round(lag / _BEST_LAG)))
        reasons.append(f"{follows}, which is {lag / factor:.2g} times the step")
    step = factor * interval
    sampled = "the sampling interval" if factor == 1 else f"{factor:g} sampling intervals of {interval:g} s"
    sentences = [f"The step is {step:g} s, {sampled}: {'; '.join(reasons)}."]
    if edge:
        sentences.append(
            f"Warning: the best lag of {edge} pairs lies at the edge of the range that was searched, "
            f"{_LARGEST_LAG * interval:g} s; a longer step may suit them better."
        )
    if lag is not None and lag / factor < 1:
        sentences.append("Warning: the step is longer than the delay, because of the noise; leaders may be missed.")
    return StepChoice(step, tuple(sentences), noise, None if lag is None else lag * interval)


def _sample_velocities(tracks: Tracks, interval: float) -> Floats:
    """Velocities of a part of the tracks at the sampling interval, ``(T, n, 3)`` metres per interval; NaN unseen.

    The part is the stretch of time in which most samples lie, and its longest tracks.
    """
    length = _PART * interval
    edges = np.arange(0.0, tracks.duration + length, length / 2)
    counts = np.histogram(tracks.time, edges)[0] if len(edges) > 1 else np.ones(1)
    pairs = counts[:-1] + counts[1:] if len(counts) > 1 else counts
    begin = float(edges[int(pairs.argmax())])
    low = np.empty(len(tracks.ids), np.int64)
    high = np.empty(len(tracks.ids), np.int64)
    for i, (first, last) in enumerate(zip(tracks.offsets[:-1], tracks.offsets[1:], strict=True)):
        low[i], high[i] = first + np.searchsorted(tracks.time[first:last], (begin, begin + length))
    longest = np.argsort(low - high, kind="stable")[:_POOL]
    instants = int(min(_PART, tracks.duration / interval)) + 1
    place = np.full((instants, len(longest), 3), np.nan)
    for k, i in enumerate(longest):
        if high[i] - low[i] < 2:
            continue
        part = slice(int(low[i]), int(high[i]))
        number, where, _ = _resample_one(tracks.time[part] - begin, tracks.position[part], interval, None)
        inside = (number >= 0) & (number < instants)
        place[number[inside], k] = where[inside]
    return np.diff(place, axis=0)


def _noise(velocity: Floats) -> tuple[float, int]:
    """Estimate the noise of the positions, metres, and the steps after which the movement exceeds it enough."""
    mean = np.nanmean(velocity, axis=(0, 1)) if np.isfinite(velocity).any() else np.zeros(3)
    centred = np.nan_to_num(velocity - mean)
    known = np.isfinite(velocity[..., 0])

    def covariance(lag: int) -> float:
        both = known[lag:] & known[: len(known) - lag]
        total = (centred[lag:] * centred[: len(centred) - lag]).sum()
        return float(total / max(int(both.sum()), 1))

    if len(velocity) < 8:
        return 0.0, 1
    total = covariance(0)
    variance = max(0.0, 2 * covariance(2) - covariance(3) - covariance(1))  # summed over the axes
    if variance < 0.01 * total:
        return 0.0, 1
    place = np.cumsum(np.nan_to_num(velocity), axis=0)
    needed = 1
    while needed < min(_LARGEST_LAG, len(place) // 4):
        moved = float(((place[needed:] - place[:-needed]) ** 2).sum(axis=2).mean())
        if moved - 2 * variance >= _SIGNAL * 2 * variance / needed:
            break
        needed += 1
    axes = max(int((np.abs(centred).sum(axis=(0, 1)) > 0).sum()), 1)
    return float(np.sqrt(variance / axes)), needed


def _lag(velocity: Floats, width: int) -> tuple[float | None, int, int]:
    """Find after how many samples ids follow their neighbours, at the time scale that shows it for the most pairs.

    Scales double from ``width`` up to 16 samples; the shortest of those that are equally good counts.

    Returns:
        As :func:`_lag_at`.
    """
    found = [_lag_at(velocity, width << k) for k in range(5) if k == 0 or width << k <= _LARGEST_SCALE]
    return max(found, key=lambda each: (each[0] is not None, each[2]))


def _lag_at(velocity: Floats, width: int) -> tuple[float | None, int, int]:
    """Find after how many samples ids follow their neighbours, at one time scale.

    What is correlated are changes: the mean velocity over ``width`` samples less that over the ``width`` samples before
    it. Velocities that are sampled faster than they change would be correlated at all lags.

    Returns:
        The median lag over the pairs whose peak is significant and not at 0 (``None`` if they are fewer than three),
        the number of pairs whose peak lies at the edge of the range, and the number of pairs.
    """
    steps, ids = velocity.shape[:2]
    largest = min(_LARGEST_LAG, steps // 4)
    if largest < 2 or ids < 2 or steps < 4 * width:
        return None, 0, 0
    centred = np.nan_to_num(velocity - _mean_of_known(velocity))
    total = np.concatenate([np.zeros((1, ids, 3)), np.cumsum(centred, axis=0)])
    centred = total[2 * width :] - 2 * total[width:-width] + total[: -2 * width]
    size = np.sqrt((centred**2).sum(axis=(0, 2)))
    centred = centred / np.where(size > 0, size, np.inf)[:, None]
    padded = 2 ** int(np.ceil(np.log2(steps + largest)))
    spectrum = np.fft.rfft(centred, padded, axis=0)
    focal = np.linspace(0, ids - 1, min(ids, _FOCAL)).astype(int)
    near = np.argsort(-np.abs(_correlate(spectrum, focal, padded, 0)), axis=1)[:, : _NEIGHBOURS + 1]
    lags, edge = [], 0
    for k, i in enumerate(focal):
        others = np.array([j for j in near[k] if j != i])
        product = (spectrum[:, [i]] * np.conj(spectrum[:, others])).sum(axis=2)
        whole = np.fft.irfft(product, padded, axis=0)
        curve = np.concatenate([whole[-largest:], whole[: largest + 1]])  # lags -largest to largest
        peak = curve.argmax(axis=0)
        middle = np.median(curve, axis=0)
        spread = 1.4826 * np.median(np.abs(curve - middle), axis=0)
        sure = curve.max(axis=0) > middle + _SIGNIFICANT * spread + 4 / np.sqrt(3 * steps)
        edge += int((sure & ((peak == 0) | (peak == 2 * largest))).sum())
        lags += np.abs(peak - largest)[sure & (peak != largest)].tolist()
    if len(lags) < min(_FEWEST_PAIRS, ids - 1):
        return None, 0, len(lags)
    return float(np.median(lags)), edge if edge > len(lags) / 2 else 0, len(lags)


def _mean_of_known(velocity: Floats) -> Floats:
    """Mean of the known velocities of each id, ``(n, 3)``."""
    known = np.isfinite(velocity[..., 0]).sum(axis=0)
    return np.nansum(velocity, axis=0) / np.maximum(known, 1)[:, None]


def _correlate(spectrum: NDArray[np.complex128], focal: NDArray[np.intp], padded: int, lag: int) -> Floats:
    """Largest absolute correlation of each focal id with each id over short lags, ``(f, n)``."""
    out = np.zeros((len(focal), spectrum.shape[1]))
    for k, i in enumerate(focal):
        product = np.einsum("fnd,fd->fn", spectrum, np.conj(spectrum[:, i]))
        whole = np.abs(np.fft.irfft(product, padded, axis=0))
        out[k] = np.maximum(whole[: _LARGEST_LAG + 1].max(axis=0), whole[-_LARGEST_LAG:].max(axis=0))
    return out
