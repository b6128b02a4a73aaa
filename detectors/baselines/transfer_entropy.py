"""Transfer entropy between velocities, estimated by nearest neighbours."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field
from scipy.special import digamma

from detectors.baselines.networks import Flight, NetworkDetector, Pairs, correlate_flights
from usnet_env.arrays import Floats, Indices, Mask
from usnet_env.compiling import compiled
from usnet_env.series import centre_columns, scale_to_unit

_MOST_ROWS = 200  # of a window; more are thinned out


class TransferEntropy(NetworkDetector):
    """Net transfer entropy: what j's past adds about i's velocity beyond i's own past, less the reverse.

    The transfer entropy (Schreiber, Physical Review Letters 85, 2000) from j to i with the delay τ (Wibral et al., PLoS
    ONE 8, 2013) is the conditional mutual information of v_i(t) and v_j(t - τ), given v_i(t - 1). It is estimated by
    counting neighbours (Kraskov, Stögbauer and Grassberger, Physical Review E 69, 2004; Frenzel and Pompe, Physical
    Review Letters 99, 2007). The delay of a pair is the lag with the highest correlation of velocities.

    Args:
        neighbours: k, the number of nearest neighbours, at least 1.
    """

    neighbours: Annotated[int, Field(ge=1, le=20)] = 4

    def pairs(self, flight: Flight, lags: int, needed: Mask | None = None) -> Pairs:
        """Estimate the transfer entropy of all pairs, in nats."""
        _, delay = correlate_flights(flight.velocity, flight.seen, lags)
        entropy = estimate_transfer_entropy(flight.velocity, flight.seen, delay, int(self.neighbours), needed)
        return Pairs(entropy, entropy - entropy.T, delay)


def estimate_transfer_entropy(
    velocity: Floats, seen: Mask, delay: Indices, neighbours: int, needed: Mask | None = None
) -> Floats:
    """Estimate the transfer entropy ``(n, n)``, in nats, of the ``needed`` pairs; entry (i, j) is from j to i.

    It is 0 where a UAV never varies or too few times are seen. Of the velocities ``(T, n, 3)`` at more than 200 times,
    200 are used. The ``delay`` ``(n, n)`` is at least 1 step.
    """
    unit = scale_to_unit(centre_columns(velocity, seen)) * np.sqrt(np.maximum(seen.sum(axis=0), 1))[:, None]
    series = np.ascontiguousarray(unit.swapaxes(0, 1), np.float32)
    first = int(delay.max(initial=1))
    rows = np.unique(np.linspace(first, len(velocity) - 1, min(_MOST_ROWS, len(velocity) - first)).astype(np.int64))
    entropy = np.zeros(delay.shape)
    table = digamma(np.arange(len(rows) + 2).clip(1))
    pairs = np.ones(delay.shape, bool) if needed is None else needed
    _estimate(series, seen.T.copy(), delay, rows, neighbours, table, pairs, entropy)
    is_moving = (series != 0).any(axis=(1, 2))
    return np.where(is_moving[:, None] & is_moving, entropy, 0.0)


@compiled(error_model="numpy")
def _estimate(series, seen, delay, rows, neighbours, table, needed, entropy):
    uavs, count = len(series), len(rows)
    present, own_past = np.empty((count, count), np.float32), np.empty((count, count), np.float32)
    past = np.empty((count, count), np.float32)
    distance, nearest = np.empty(count, np.float32), np.empty(neighbours, np.float32)
    is_usable = np.empty(count, np.bool_)
    unseen = np.float32(1e30)
    for i in range(uavs):
        if not needed[i].any():
            continue
        _measure_distances(series[i], rows, present)
        _measure_distances(series[i], rows - 1, own_past)
        for j in range(uavs):
            if i == j or not needed[i, j]:
                continue
            lag = delay[i, j]
            for r in range(count):
                is_usable[r] = seen[i, rows[r]] and seen[i, rows[r] - 1] and seen[j, rows[r] - lag]
            usable = is_usable.sum()
            if usable <= neighbours + 1:
                continue
            _measure_distances(series[j], rows - lag, past)
            for r in range(count):
                if not is_usable[r]:
                    past[r, :] = past[:, r] = unseen
            total = 0.0
            for r in range(count):
                if not is_usable[r]:
                    continue
                for s in range(count):
                    distance[s] = max(present[r, s], own_past[r, s], past[r, s])
                distance[r] = unseen
                nearest[:] = unseen
                for s in range(count):
                    if distance[s] < nearest[neighbours - 1]:
                        k = neighbours - 1
                        while k > 0 and nearest[k - 1] > distance[s]:
                            nearest[k] = nearest[k - 1]
                            k -= 1
                        nearest[k] = distance[s]
                limit = nearest[neighbours - 1]
                matches = with_present = with_past = 0
                for s in range(count):
                    is_near = own_past[r, s] < limit
                    matches += is_near & (past[r, s] < unseen)
                    with_present += is_near & (present[r, s] < limit) & (past[r, s] < unseen)
                    with_past += is_near & (past[r, s] < limit)
                total += table[matches] - table[with_present] - table[with_past]  # the counts hold the row itself
            entropy[i, j] = table[neighbours] + total / usable


@compiled()
def _measure_distances(series, times, squared):
    """Squared distances between the rows of ``series`` ``(T, 3)`` at these times."""
    x, y, z = series[times, 0], series[times, 1], series[times, 2]
    for r in range(len(times)):
        for s in range(len(times)):
            squared[r, s] = (x[r] - x[s]) ** 2 + (y[r] - y[s]) ** 2 + (z[r] - z[s]) ** 2
