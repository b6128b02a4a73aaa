"""Networks from correlations and regressions of movement, and the UAV that flies in front."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field

from detectors.baselines.networks import Flight, NetworkDetector, Pairs, correlate_flights
from detectors.series.designs import centre_past
from detectors.series.regressions import explain_pairs
from usnet_env.arrays import Floats, Mask
from usnet_env.compiling import compiled
from usnet_env.detection import Tags
from usnet_env.series import centre_columns, correlate_at_lag, correlate_over_lags, scale_to_unit


def _compute_directions(velocity: Floats) -> Floats:
    speed = np.sqrt((velocity**2).sum(axis=-1, keepdims=True))
    return np.where(speed > 0, velocity / np.where(speed > 0, speed, 1.0), 0.0)


class DirectionalDelays(NetworkDetector):
    """Directional correlation with a delay for each pair (Nagy, Akos, Biro and Vicsek, Nature 464, 2010).

    C_ij(τ) is the mean scalar product of i's direction of flight and that of j τ steps earlier. The delay of a pair is
    the τ from -L to L with the highest C_ij(τ); j leads i if it is positive. Directions are centred over the window.
    The lead is max_{τ>0} C_ij(τ) - max_{τ>0} C_ji(τ) for a positive delay, otherwise 0.
    """

    def pairs(self, flight: Flight, lags: int, needed: Mask | None = None) -> Pairs:
        """Correlate the directions of flight."""
        direction = _compute_directions(flight.velocity)
        lagged, delay = correlate_flights(direction, flight.seen, lags)
        unit = scale_to_unit(centre_columns(direction, flight.seen))
        unlagged = correlate_at_lag(unit, unit, 0)
        delayed = np.maximum(lagged, unlagged) > np.maximum(unlagged, lagged.T)  # the highest is at a positive lag
        net = lagged - lagged.T
        return Pairs(lagged, np.where(delayed | delayed.T, net, 0.0), delay)


class LaggedNetwork(NetworkDetector):
    """Network of time-lagged correlations of velocity, acceleration and direction.

    After da Silva and Maia, Leadership Detection via Time-Lagged Correlation-Based Network Inference
    (arXiv:2507.04917, 2025). The lagged correlations of the three series, the highest over the lags each, are averaged;
    the lead of j over i is the average for i behind j less that for j behind i.
    """

    def pairs(self, flight: Flight, lags: int, needed: Mask | None = None) -> Pairs:
        """Correlate velocities, accelerations and directions."""
        both_seen = flight.seen.copy()
        both_seen[1:] &= flight.seen[:-1]
        both_seen[0] = False
        change = np.zeros_like(flight.velocity)
        change[1:] = np.diff(flight.velocity, axis=0)
        strength, delay = correlate_flights(flight.velocity, flight.seen, lags)
        accelerations, _ = correlate_flights(np.where(both_seen[..., None], change, 0.0), both_seen, lags)
        directions, _ = correlate_flights(_compute_directions(flight.velocity), flight.seen, lags)
        mean = np.mean([strength, accelerations, directions], axis=0)
        return Pairs(mean, mean - mean.T, delay)


class NetLagRegression(NetworkDetector):
    """Net time-lag regression: how much better j's past explains i's velocity than i's past explains j's.

    The velocity of i is regressed on that of j at the lags 1 to L, fewer in short windows (ridge regression, one for
    each pair). The lead is the difference of the explained shares of both directions.
    """

    def pairs(self, flight: Flight, lags: int, needed: Mask | None = None) -> Pairs:
        """Regress all pairs."""
        lags = max(1, min(lags, len(flight.velocity) // 8))
        target = centre_columns(flight.velocity[lags:], flight.seen[lags:])
        past: Floats = centre_past(flight.velocity, flight.seen, lags)
        shares, _ = explain_pairs(past, [target])
        return Pairs(shares[0], shares[0] - shares[0].T)


class FrontMost(NetworkDetector):
    """Names the UAV that flies in front of those that move like it.

    j is in front of i by the mean cosine of the angle between the way from i to j and their common velocity. Two UAVs
    move alike if the mean scalar product of their directions, at some lag from -L to L, is at least ``alike``, as in
    Nagy et al. (2010); other pairs are not compared.

    Args:
        alike: the least correlation of directions, from 0 to 1.
    """

    tags = Tags(most_uavs=10_000, least_steps=5)
    _gated = False

    alike: Annotated[float, Field(ge=0, le=1)] = 0.5

    def pairs(self, flight: Flight, lags: int, needed: Mask | None = None) -> Pairs:
        """Compare the places of all pairs along their common velocity."""
        course = scale_to_unit(_compute_directions(flight.velocity))
        correlation = correlate_over_lags(course, course, lags, least=-lags)
        by_uav = (values.swapaxes(0, 1).copy() for values in (flight.place, flight.velocity, flight.seen))
        return Pairs(correlation, np.where(correlation >= self.alike, _compare_positions(*by_uav), 0.0))


@compiled()
def _compare_positions(position: Floats, velocity: Floats, seen: Mask) -> Floats:
    """How far UAV j is ahead of UAV i, ``(n, n)``, from place and velocity ``(n, T, d)`` and seen ``(n, T)``."""
    uavs, steps, axes = position.shape
    lead = np.zeros((uavs, uavs))
    for i in range(uavs):
        for j in range(i + 1, uavs):
            cosines, count = 0.0, 0
            for t in range(steps):
                if not (seen[i, t] and seen[j, t]):
                    continue
                count += 1
                product = offset_power = course_power = 0.0
                for k in range(axes):
                    offset, course = position[j, t, k] - position[i, t, k], velocity[j, t, k] + velocity[i, t, k]
                    product += offset * course
                    offset_power += offset**2
                    course_power += course**2
                if offset_power > 0 and course_power > 0:
                    cosines += product / (np.sqrt(offset_power) * np.sqrt(course_power))
            if count:
                lead[i, j] = cosines / count
                lead[j, i] = -lead[i, j]
    return lead
