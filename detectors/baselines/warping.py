"""Following networks by dynamic time warping: FLICA and mFLICA (Amornbunchornvej et al., 2018)."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field

from detectors.baselines.factions import compute_pagerank
from detectors.baselines.networks import Flight, NetworkDetector, Pairs
from usnet_env.arrays import Floats, Indices, Mask
from usnet_env.compiling import compiled
from usnet_env.detection import Detection, Tags
from usnet_env.series import centre_columns
from usnet_env.window import Window


class Mflica(NetworkDetector):
    """Following network by dynamic time warping; the leaders of factions follow no UAV.

    After Amornbunchornvej and Berger-Wolf, Framework for inferring leadership dynamics of complex movement from time
    series (SIAM International Conference on Data Mining, 2018). Two tracks are warped onto each other: a path of pairs
    of times (a, b), at most L apart, minimises the sum of squared distances between i at a and j at b. The lead of j
    over i is the mean sign of a - b along the path. The published method takes one threshold for the lead from the
    user; here it comes from surrogates, as in all detectors on networks.
    """

    tags = Tags(most_uavs=10_000, least_steps=5)
    _gated = False

    max_lag: Annotated[int, Field(ge=1, le=1000)] = 8

    def pairs(self, flight: Flight, lags: int, needed: Mask | None = None) -> Pairs:
        """Warp all pairs."""
        position = np.ascontiguousarray(flight.place.swapaxes(0, 1))
        lead, cost, delay = warp_pairs(position, flight.seen.T.copy(), lags)
        spread = (centre_columns(flight.place, flight.seen) ** 2).sum(axis=2).mean(axis=0)
        total = spread[:, None] + spread
        match = "whose places match its earlier ones"
        return Pairs(1.0 - cost / np.where(total > 0, total, 1.0), lead, np.maximum(delay, 1), match)


class Flica(Mflica):
    """Following network by dynamic time warping; the initiator is the UAV with the highest PageRank.

    After Amornbunchornvej, Brugere, Strandburg-Peshkin, Farine, Crofoot and Berger-Wolf, Coordination event detection
    and initiator identification in time series data (ACM Transactions on Knowledge Discovery from Data 12(5), 2018).
    The network is that of :class:`Mflica`; one group with one leader is assumed, and all that follow any UAV follow it.
    """

    def detect(self, window: Window) -> Detection:
        """Name the UAV with the highest PageRank in the network, or none if no UAV follows another one."""
        found = super().detect(window)
        assert found.attention is not None
        network = np.where(found.attention > found.extras["threshold"], found.attention, 0.0)
        scores = np.where(window.alive, compute_pagerank(network).round(12), 0.0)  # equal ranks are ties
        linked = network.any(axis=1) | network.any(axis=0)
        head = int(np.where(linked, scores, -1.0).argmax()) if linked.any() else -1
        candidates = np.arange(window.uavs) == head
        return Detection(candidates, scores, np.where(linked, 0, -1), np.where(linked, head, -1), found.attention)


@compiled()
def warp_pairs(values: Floats, seen: Mask, band: int) -> tuple[Floats, Floats, Indices]:
    """Warp each pair of the series ``values`` ``(n, T, d)`` onto each other, with times at most ``band`` steps apart.

    A time at which one of both is not ``seen`` ``(n, T)`` costs nothing. Returns ``(n, n)`` each: the mean sign of
    (time in i - time in j) along the path, the mean cost of its steps, and the median of that difference.
    """
    uavs, steps, axes = values.shape
    lead, cost, delay = np.zeros((uavs, uavs)), np.zeros((uavs, uavs)), np.zeros((uavs, uavs), np.int64)
    width = 2 * band + 1
    total = np.empty((steps, width))
    step = np.empty((steps, width), np.int8)  # from: 0 both earlier, 1 i earlier, 2 j earlier
    counts = np.empty(width, np.int64)
    for i in range(uavs):
        for j in range(i + 1, uavs):
            for a in range(steps):
                for c in range(width):
                    b = a + c - band
                    total[a, c] = np.inf
                    if b < 0 or b >= steps:
                        continue
                    least, source = np.inf, 0
                    if a == 0 and b == 0:
                        least = 0.0
                    if a > 0 and b > 0:
                        least = total[a - 1, c]
                    if a > 0 and c + 1 < width and total[a - 1, c + 1] < least:
                        least, source = total[a - 1, c + 1], 1
                    if b > 0 and c > 0 and total[a, c - 1] < least:
                        least, source = total[a, c - 1], 2
                    if seen[i, a] and seen[j, b]:
                        for k in range(axes):
                            least += (values[i, a, k] - values[j, b, k]) ** 2
                    total[a, c] = least
                    step[a, c] = source
            a, c, length, sign = steps - 1, band, 0, 0
            counts[:] = 0
            while True:
                length += 1
                counts[c] += 1
                if c < band:
                    sign += 1
                elif c > band:
                    sign -= 1
                if a == 0 and c == band:
                    break
                source = step[a, c]
                if source == 0:
                    a -= 1
                elif source == 1:
                    a -= 1
                    c += 1
                else:
                    c -= 1
            lead[i, j] = sign / length
            lead[j, i] = -sign / length
            cost[i, j] = cost[j, i] = total[steps - 1, band] / length
            cumulated, c = counts[0], 0
            while 2 * cumulated < length:
                c += 1
                cumulated += counts[c]
            delay[i, j] = band - c
            delay[j, i] = c - band
    return lead, cost, delay
