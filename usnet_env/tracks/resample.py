"""Put tracks on one grid of times: leave out spikes, choose the step, and fit or interpolate the positions."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import pandas as pd

from usnet_env.arrays import Floats, Indices
from usnet_env.config import ArgumentError, format_number, format_seconds
from usnet_env.series import find_middle
from usnet_env.tracks.samples import Samples, SamplesT, keep_samples

_MAX_SPIKE_SHARE = 0.05  # of the samples; where more are off the track, in more parts than ids, none is wrong
JUMP = 5.0  # a jump is faster than this many times the speed that 95 % of the steps don't exceed
_GROSS_JUMP = 20.0  # times the usual speed; such a jump has the squared length of more than 400 steps

_MAX_ROUNDS = 3  # a part between two excursions may be left out first, and they as one after it
_MIN_FIT_SAMPLES = 3  # samples within a grid step from which a straight line is fitted
_TIME_TOLERANCE = 1e-6  # grid steps; times that differ by less are the same
_TYPICAL_SHARE, _BRIDGE_FACTOR = 0.9, 1.5  # intervals up to 1.5 times that of this quantile are interpolated
_MAX_GRID_SAMPLES = 10**8  # samples of the result

# The choice of the step looks at a part of the tracks: followers, ids in all, steps, and samples.
_FOCAL_IDS, _POOL_IDS, _PART_STEPS, _MAX_SAMPLES = 48, 400, 2048, 2**21
LAGS = 4  # steps in which delays lie; detectors look at least as far back
_STEPS_PER_STAY, _MIN_STEPS = 100, 16  # of the longest step that is tried; of the shortest
_STEP_GROWTH = 2**0.5  # from one step that is tried to the next
_SHIFTS = 64
_MAX_DELAY_PART = 8  # delays of up to this part of the tracks are looked at
_IDS_PER_FOLLOWER = 16  # one in this many ids must follow another
_SIGNIFICANT = 5.0  # a lead exceeds those of shifted tracks by this many robust standard deviations
_MIN_LEAD_SHARE = 0.8  # the shortest step whose lead is at least this share of the largest is chosen
_MIN_SIGNAL = 4.0  # in a step, the squared movement should exceed the noise of the squared movement this many times
_LONGER_FACTORS = (2, 4, 8, 16)  # times the shortest step that are tried, too, if no lead is found
_UNLED_FACTOR, _UNLED_STEPS = 4, 50  # without a lead: times the shortest step, and steps of a stay that must remain
_LARGEST_SCALE = 64  # samples; the noise asks for no longer step


def typical_intervals(tracks: Samples) -> Floats:
    """``(N,)`` median interval between the samples of each id, seconds; NaN for an id with fewer than two samples."""
    inner = tracks.inner_steps
    medians = pd.Series(np.diff(tracks.time)[inner]).groupby(tracks.owner[:-1][inner]).median()
    return medians.reindex(range(len(tracks.ids))).to_numpy()


class Jumps(NamedTuple):
    """The jumps of some tracks."""

    steps: Indices  # the samples after which a track jumps
    spikes: Indices  # samples off the track: see find_jumps
    speed: Floats  # (S - 1,) metres per second from each sample to the next of its id; 0 between ids
    typical_speed: float  # the speed that 95 % of the steps of moving ids don't exceed


def find_jumps(tracks: Samples) -> Jumps:
    """Find the steps that are more than 5 times as fast as 95 % of the steps, and the samples off the track.

    These are the samples between two jumps if the way past them is no jump, at most half of an id's; repetitions of a
    position before a jump that is none from the first of them on; and two or more equal ones at an end, apart by a
    jump. If they are more than 5 % of all samples, in more parts than ids, these move rarely, and none is off.
    """
    samples, inner = np.arange(tracks.samples), tracks.inner_steps
    length = np.linalg.norm(np.diff(tracks.position, axis=0), axis=1)
    speed = length / np.where(inner, np.diff(tracks.time), np.inf)
    moving_speeds = speed[speed > 0]
    typical_speed = float(np.quantile(moving_speeds, 0.95)) if len(moving_speeds) else 0.0
    steps = np.flatnonzero(speed > JUMP * typical_speed)
    owner = tracks.owner[steps]
    begin, end = tracks.offsets[owner], tracks.offsets[owner + 1]
    first_equal = np.maximum.accumulate(np.where(np.append(True, (length > 0) | ~inner), samples, 0))
    # What is between low and high may be left out: samples between two jumps, or repetitions before one.
    low, high = np.append(steps[:-1], first_equal[steps]), np.append(steps[1:], steps) + 1
    distance = np.linalg.norm(tracks.position[high] - tracks.position[low], axis=1)
    is_excursion = distance <= JUMP * typical_speed * (tracks.time[high] - tracks.time[low])
    max_samples = np.append((end - begin)[1:] / 2, np.full(len(steps), tracks.samples))
    is_excursion &= (low >= np.append(begin[1:], begin)) & (high - low <= 1 + max_samples)
    is_off = np.zeros(tracks.samples, bool)
    for k in np.argsort(high - low, kind="stable"):  # a short excursion is not the way between two others
        if is_excursion[k] and not is_off[[low[k], high[k]]].any():
            is_off[low[k] + 1 : high[k]] = True
    for step, first, last in zip(steps, begin, end, strict=True):
        if first_equal[step] == first < step and 2 * (step + 1 - first) < last - first:
            is_off[first : step + 1] = True
        if first_equal[last - 1] == step + 1 < last - 1 and 2 * (last - step - 1) < last - first:
            is_off[step + 1 : last] = True
    if is_off.sum() > _MAX_SPIKE_SHARE * tracks.samples and np.diff(is_off, prepend=False).sum() > 2 * len(tracks.ids):
        is_off[:] = False
    return Jumps(steps, np.flatnonzero(is_off), speed, typical_speed)


def leave_out_spikes(tracks: SamplesT) -> SamplesT:
    """The tracks without the samples off the track."""
    for _ in range(_MAX_ROUNDS):
        if not len(spikes := find_jumps(tracks).spikes):
            break
        tracks = keep_samples(tracks, ~np.isin(np.arange(tracks.samples), spikes))
    return tracks


def close_jumps(tracks: SamplesT) -> tuple[SamplesT, int]:
    """The tracks with gross jumps, 20 times as fast as usual, of no length: each goes on from where it was before."""
    steps, _, speed, typical_speed = find_jumps(tracks)
    jumps = steps[speed[steps] > _GROSS_JUMP * typical_speed]
    offset = np.zeros_like(tracks.position)
    offset[jumps + 1] = tracks.position[jumps + 1] - tracks.position[jumps]
    offset = np.cumsum(offset, axis=0)  # within an id: all jumps up to a sample, less those of the ids before
    if len(jumps):
        tracks = replace(tracks, position=tracks.position - (offset - offset[tracks.offsets[tracks.owner]]))
    return tracks, len(jumps)


def leave_out_heights(tracks: SamplesT) -> tuple[SamplesT, float]:
    """The tracks without heights whose noise exceeds the movement of the other axes, and that noise in metres.

    Otherwise the noise is 0.
    """
    if tracks.dimensions == 2:
        return tracks, 0.0
    velocity = _sample_velocities(tracks, float(np.nanmedian(typical_intervals(tracks))))
    noise, needed = _estimate_noise(velocity[..., 2:])[0], _estimate_noise(velocity[..., :2])[1]
    position = np.cumsum(np.nan_to_num(velocity[..., :2]), axis=0)
    displacements = position[needed:] - position[:-needed]
    mean_square = float((displacements**2).sum(axis=2).mean()) if len(displacements) else np.inf
    if 2 * noise**2 <= max(mean_square, 1e-6 * float(np.nanmean(velocity[..., 2] ** 2))):
        return tracks, 0.0
    return replace(tracks, position=tracks.position * (1.0, 1.0, 0.0)), noise


def typical_stay(tracks: Samples) -> float:
    """The median of the seconds from the first to the last sample of an id that has two."""
    filled = np.flatnonzero(np.diff(tracks.offsets) > 1)
    return float(np.median(tracks.time[tracks.offsets[filled + 1] - 1] - tracks.time[tracks.offsets[filled]]))


def resample_positions(tracks: SamplesT, step: float, max_gap: float | None) -> SamplesT:
    """The tracks at the times 0, ``step``, 2 ``step``, ...; see :meth:`Tracks.resample`."""
    parts = [slice(int(first), int(last)) for first, last in pairwise(tracks.offsets)]
    filled = [i for i, part in enumerate(parts) if part.stop - part.start > 1]
    if len(filled) * tracks.duration / step > _MAX_GRID_SAMPLES:  # gaps may leave fewer
        needed = sum(_number_grid(tracks.time[parts[i]] / step, step, max_gap)[1].sum() for i in filled)
        if needed > _MAX_GRID_SAMPLES:
            count = f"{needed:g} samples of at most {_MAX_GRID_SAMPLES:g}"
            raise ArgumentError(f"step must be longer, got {step:g} s, {count}.")
    grids = [_resample_one(tracks.time[parts[i]], tracks.position[parts[i]], step, max_gap) for i in filled]
    counts = np.zeros(len(parts), np.int64)
    counts[filled] = [len(grid[0]) for grid in grids]
    times, positions = (np.concatenate([grid[k] for grid in grids]) for k in (0, 1))
    leader = tracks.leader
    if leader is not None:
        leader = np.concatenate([leader[parts[i]][grid[2]] for i, grid in zip(filled, grids, strict=True)])
    offsets = np.concatenate([[0], np.cumsum(counts)])
    return replace(tracks, offsets=offsets, time=times * step, position=positions, leader=leader, step=step)


def _resample_one(
    time: Floats, position: Floats, step: float, max_gap: float | None
) -> tuple[Indices, Floats, Indices]:
    """Resample one track ``(S,)``, ``(S, 3)``: numbers of the grid times ``(G,)``, positions, and nearest samples."""
    steps = time / step
    low, count = _number_grid(steps, step, max_gap)
    number = np.repeat(low - np.cumsum(count) + count, count) + np.arange(int(count.sum()))
    next_sample = np.clip(np.searchsorted(steps, number - _TIME_TOLERANCE), 1, len(steps) - 1)
    last_sample = next_sample - 1
    interval = steps[next_sample] - steps[last_sample]
    share = np.clip((number - steps[last_sample]) / interval, 0.0, 1.0)
    on_grid = np.minimum(share, 1 - share) * interval <= _TIME_TOLERANCE  # a sample lies at the grid time
    share = np.where(on_grid, np.round(share), share)
    resampled = position[last_sample] + share[:, None] * (position[next_sample] - position[last_sample])
    nearest = np.where(share < 0.5, last_sample, next_sample)
    if len(number) and _find_quantile(np.diff(steps), 0.5) <= 1 / 2:
        _fit_lines(steps, position, number, resampled)
    return number, resampled, nearest


def _number_grid(steps: Floats, step: float, max_gap: float | None) -> tuple[Indices, Indices]:
    """The first grid time from each sample on, and the number of those before the next; times are in steps."""
    interval = np.diff(steps)
    typical = max(_BRIDGE_FACTOR * _find_quantile(interval, _TYPICAL_SHARE), 1.0)
    max_interval = typical if max_gap is None else max_gap / step
    low = np.ceil(steps - _TIME_TOLERANCE).astype(np.int64)
    count = (low - steps <= _TIME_TOLERANCE).astype(np.int64)
    is_bridged = interval <= max_interval * (1 + _TIME_TOLERANCE)
    count[:-1] = np.where(is_bridged, np.diff(low), count[:-1])
    return low, count


def _find_quantile(values: Floats, quantile: float) -> float:
    """As ``np.quantile``, which takes ten times as long for few values."""
    rank = quantile * (len(values) - 1)
    low, high = int(rank), min(int(rank) + 1, len(values) - 1)
    ordered = np.partition(values, (low, high))
    return float(ordered[low] + (rank - low) * (ordered[high] - ordered[low]))


def _fit_lines(steps: Floats, position: Floats, number: Indices, resampled: Floats) -> None:
    """Replace ``resampled`` ``(G, 3)`` by straight lines fitted within half a step, where there are enough samples."""
    cell = np.floor(steps + 0.5).astype(np.int64)
    starts = np.flatnonzero(np.diff(cell, prepend=cell[0] - 1))
    numbers, sizes = cell[starts], np.diff(np.append(starts, len(steps)))
    u, p = steps - cell, position - np.repeat(position[starts], sizes, axis=0)
    count = sizes.astype(np.float64)
    sum_u, sum_uu = np.add.reduceat(u, starts), np.add.reduceat(u * u, starts)
    sum_p, sum_up = np.add.reduceat(p, starts, axis=0), np.add.reduceat(u[:, None] * p, starts, axis=0)
    spread = count * sum_uu - sum_u**2
    encloses = (np.minimum.reduceat(u, starts) <= 0) & (np.maximum.reduceat(u, starts) >= 0)
    is_fitted = (count >= _MIN_FIT_SAMPLES) & encloses & (spread > 1e-4 * count**2)
    line = (sum_uu[:, None] * sum_p - sum_u[:, None] * sum_up) / np.where(is_fitted, spread, 1.0)[:, None]
    cells = np.minimum(np.searchsorted(numbers, number), len(numbers) - 1)
    replaced = (numbers[cells] == number) & is_fitted[cells]
    resampled[replaced] = (position[starts] + line)[cells[replaced]]


def choose_step(tracks: Samples, length: int = 0) -> tuple[float, str]:
    """Choose the step of the grid, in seconds, and say why in a sentence; an id must have two samples.

    Steps are tried from one in which the movement exceeds its noise four times, each √2 times as long as the last, as
    long as the typical stay of an id has 100 of them; it has 16, or half a window of ``length``, if it lasts so long.
    """
    interval = float(f"{np.nanmedian(typical_intervals(tracks)):.9g}")  # differences of times have rounding errors
    noise, needed = _estimate_noise(_sample_velocities(tracks, interval))
    stay = typical_stay(tracks) / interval
    needed = min(needed, max(1, int(stay / max(_MIN_STEPS, length / 2))))
    longest = max(1.0, stay / (_STEPS_PER_STAY * needed))  # compared with the shortest step
    powers = np.arange(1 + max(0, int(np.floor(np.log(longest) / np.log(_STEP_GROWTH) + 1e-9))))
    factors = sorted({round(needed * _STEP_GROWTH ** int(k)) for k in powers})
    leads = [_find_leads(_sample_velocities(tracks, factor * interval)) for factor in factors]
    max_factor = stay / max(_MIN_STEPS, length / 2)
    for factor in (f * needed for f in _LONGER_FACTORS if factors[-1] < f * needed <= max_factor and not max(leads)[0]):
        factors.append(factor)
        leads.append(_find_leads(_sample_velocities(tracks, factor * interval)))
    largest_lead = max(leads)[0]
    if largest_lead:
        best = next(k for k, (mean, _, _) in enumerate(leads) if mean >= _MIN_LEAD_SHARE * largest_lead)
    else:  # gait and wing beats fill short steps
        best = sum(f <= max(needed, min(_UNLED_FACTOR * needed, stay / _UNLED_STEPS)) for f in factors) - 1
    (_, lag, followers), step = leads[best], factors[best] * interval
    reason = "no id follows another with a significant delay"
    if largest_lead:
        typical = f"typical delay {format_seconds(lag * step, 2)}, median of {followers}"
        reason = f"it is the shortest at which following shows ({typical})"
    sampled = f"{factors[best]:g} times the sampling interval".removeprefix("1 times ")
    jitter = f"; the positions jitter by about {format_number(noise, 2)} {tracks.length_unit} from sample to sample"
    hidden = ", and shorter delays may be missed" if largest_lead and best == 0 and needed > 1 else ""
    return step, f"The step is {format_seconds(step)}, {sampled}: {reason}{jitter * bool(noise)}{hidden}."


def _sample_velocities(tracks: Samples, interval: float) -> Floats:
    """Velocities ``(T, n, 3)`` of the longest tracks in the 2048 steps with the most samples; NaN where unseen."""
    length = _PART_STEPS * interval
    edges = np.arange(0.0, tracks.duration + length, length / 2)
    counts = np.histogram(tracks.time, edges)[0] if len(edges) > 1 else np.ones(1)
    pairs = counts[:-1] + counts[1:] if len(counts) > 1 else counts
    begin = float(edges[int(pairs.argmax())])
    low, high = np.empty((2, len(tracks.ids)), np.int64)
    for i, (first, last) in enumerate(pairwise(tracks.offsets)):
        low[i], high[i] = first + np.searchsorted(tracks.time[first:last], (begin, begin + length))
    longest = np.argsort(low - high, kind="stable")[:_POOL_IDS]
    longest = longest[: max(2, int(np.searchsorted(np.cumsum((high - low)[longest]), _MAX_SAMPLES)) + 1)]
    instants = int(min(_PART_STEPS, tracks.duration / interval)) + 1
    position = np.full((instants, len(longest), 3), np.nan)
    for k, i in enumerate(longest[(high - low)[longest] > 1]):
        part = slice(int(low[i]), int(high[i]))
        number, points, _ = _resample_one(tracks.time[part] - begin, tracks.position[part], interval, None)
        is_inside = (number >= 0) & (number < instants)
        position[number[is_inside], k] = points[is_inside]
    return np.diff(position, axis=0)


def _estimate_noise(velocity: Floats) -> tuple[float, int]:
    """Estimate the noise of the positions, metres, and the steps after which the movement exceeds it enough.

    White noise adds -σ² to the covariance c_1 of successive steps and nothing to those further apart, so
    σ² = 2 c_2 - c_3 - c_1.
    """
    mean = np.nanmean(velocity, axis=(0, 1)) if np.isfinite(velocity).any() else np.zeros(3)
    centred = np.nan_to_num(velocity - mean)
    is_seen = np.isfinite(velocity[..., 0])

    def covariance(lag: int) -> float:
        both_seen = is_seen[lag:] & is_seen[: len(is_seen) - lag]
        total = (centred[lag:] * centred[: len(centred) - lag]).sum()
        return float(total / max(int(both_seen.sum()), 1))

    if len(velocity) < 8:
        return 0.0, 1
    variance_of_steps = covariance(0)
    variance = max(0.0, 2 * covariance(2) - covariance(3) - covariance(1))  # summed over the axes
    if variance < 0.01 * variance_of_steps:
        return 0.0, 1
    position = np.cumsum(np.nan_to_num(velocity), axis=0)
    needed = 1
    while needed < min(_LARGEST_SCALE, len(position) // 4):
        mean_square = float(((position[needed:] - position[:-needed]) ** 2).sum(axis=2).mean())
        if mean_square - 2 * variance >= _MIN_SIGNAL * 2 * variance / needed:
            break
        needed += 1
    axes = max(int((np.abs(centred).sum(axis=(0, 1)) > 0).sum()), 1)
    return float(np.sqrt(variance / axes)), needed


def _find_leads(velocity: Floats) -> tuple[float, float, int]:
    """The mean lead over the ids with velocities ``(T, n, 3)``, the median lag in steps, and the number of followers.

    The lead of j over i is max_τ C(τ) - max_τ C(-τ), τ = 1, ..., 4; C(τ) correlates the changes of i's velocity with
    those of j's τ steps before. That over i is the best j's, less the median for tracks that are shifted in time. There
    is none if C is larger at more than 4 steps, up to an eighth of the tracks, and larger than by chance.
    """
    if velocity.shape[1] < 2 or len(velocity) <= _MIN_STEPS:
        return 0.0, 0.0, 0
    times_seen = np.isfinite(velocity[..., 0]).sum(axis=0)
    mean = np.nansum(velocity, axis=0) / np.maximum(times_seen, 1)[:, None]
    changes = np.diff(np.nan_to_num(velocity - mean), axis=0)
    steps, ids = changes.shape[:2]
    size = np.sqrt((changes**2).sum(axis=(0, 2)))
    scaled = (changes / np.where(size > 0, size, np.inf)[:, None]).transpose(1, 2, 0).astype(np.float32)  # (n, 3, T)
    spectrum = np.fft.rfft(scaled)
    shifts = np.arange(_SHIFTS) * steps // _SHIFTS if steps > _SHIFTS else np.arange(steps)  # 0 is among them
    lags = np.arange(1, LAGS + 1)[:, None]
    later_shifts, earlier_shifts = (shifts + lags) % steps, (shifts - lags) % steps  # (4, S)
    focal = np.linspace(0, ids - 1, min(ids, _FOCAL_IDS)).astype(int)
    leads, delays = [], []
    for i in focal:
        curve = np.fft.irfft((spectrum[i] * np.conj(spectrum)).sum(axis=1), steps)  # (n, T): i, after each id
        shifted_leads = curve[:, later_shifts].max(axis=1) - curve[:, earlier_shifts].max(axis=1)  # (n, S)
        shifted_leads[i] = -np.inf
        chance_leads = shifted_leads[:, 1:].max(axis=0)
        short_lags = curve[:, 1 : LAGS + 1].max(axis=1)
        is_short = short_lags > curve[:, LAGS + 1]  # otherwise the delay is longer than 4 steps
        long_lags = curve[:, LAGS + 1 : max(LAGS + 2, steps // _MAX_DELAY_PART)].max(axis=1)
        repeats, chance = float(long_lags[i]), float(curve[:, steps // 4 : -(steps // 4)].max())
        if np.delete(long_lags, i).max() > max(repeats, chance):  # an id was there long before: siblings are no leaders
            is_short &= short_lags > long_lags.max()
        lead = np.where(is_short, shifted_leads[:, 0], -np.inf)
        median, spread = find_middle(chance_leads)
        if lead.max() > median + _SIGNIFICANT * spread:
            leads.append(float(lead.max()) - median)
            delays.append(1 + int(curve[lead.argmax(), 1 : LAGS + 1].argmax()))
    if len(leads) < max(1, len(focal) / _IDS_PER_FOLLOWER):
        return 0.0, 0.0, 0
    return sum(leads) / len(focal), float(np.median(delays)), len(leads)
