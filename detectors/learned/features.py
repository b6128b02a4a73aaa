"""Inputs of the network: statistics of every ordered pair of UAVs, computed by matrix products.

Entry (i, j) measures how well UAV j's past predicts UAV i's velocity. Each statistic is a share of explained variance
or a cosine; so it is invariant under rotation, translation and scaling of the swarm. Permuting the UAVs permutes the
entries.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from detectors.series.designs import centre_columns, count_lags, scale_to_unit, shift_in_time, stack_past
from detectors.series.null_models import compute_innovations
from detectors.series.regressions import correlate_at_lag, explain_pairs
from usnet_env.arrays import Mask, Singles
from usnet_env.window import Window

LAGS = 5  # number of single lags; f1 to f7 use at most 4 past steps
_JOINT_LAGS = 4  # lags of the regressions on several lags together
_ROWS_PER_FEATURE = 1.5  # least samples per feature of a regression
_LONG = 20  # with at least as many velocities, the innovation is taken against two own past velocities, otherwise one
_SPREADS = 10.0  # standardised values are clipped to this many standard deviations

_PRODUCT_LAGS = 3
_LINEAR, _QUADRATIC = 3, 6
_STATISTICS = 2 * (2 * LAGS + 1 + _PRODUCT_LAGS + 1) + 2 * (LAGS + 1) + 4 + 1
#: Number of values per pair: each statistic, and its standardised value within its row.
PAIR_FEATURES = 2 * _STATISTICS


def make_inputs(window: Window, living: NDArray[np.intp]) -> tuple[Tensor, Tensor]:
    """Make the inputs of the network for the UAVs with the indices ``living`` ``(n,)`` of a window.

    Returns:
        The result of :func:`pair_features`; and ``(3,)``: log(n / 50), log(T_ob / 100), the share of missing samples.
    """
    missing = 1.0 - float(window.velocity_seen[:, living].mean()) if len(living) else 0.0
    context = [math.log(max(len(living), 1) / 50.0), math.log(window.observation_steps / 100.0), missing]
    return torch.from_numpy(pair_features(window, living)), torch.tensor(context)


def pair_features(window: Window, living: NDArray[np.intp]) -> Singles:
    """Compute the statistics of all ordered pairs of living UAVs.

    The first statistics are computed for the velocities v and again for their innovations e, the residuals of a
    regression on a UAV's own past velocities:

    * the share of UAV i's variance that UAV j's velocity explains, by a linear and by a quadratic map, for lags 1 to
      ``LAGS``, and by products of two successive velocities, for lags 1 to 3;
    * the largest of these shares;
    * the share of the linear map at lag 0;
    * the mean cosine between the two at lags 0 to ``LAGS``.

    Then follow the shares of v_i and of e_i that a ridge on up to four lags of v_j (linear and quadratic) explains, the
    same shares with UAV i shifted by half a window (their values by chance), and the cosine between i's mean velocity
    and the direction to j. Missing samples are left out.

    Returns:
        ``(n, n, PAIR_FEATURES)`` float32. The diagonal is 0, and so is a statistic for which the window is too short.
    """
    seen = window.velocity_seen[:, living]
    velocity = _scale_velocity(window.velocity[:, living], seen)
    uavs = len(living)
    values = np.zeros((_STATISTICS, uavs, uavs), np.float32)
    if uavs:
        values[:] = [*_compute_flight_statistics(velocity, seen), _compute_direction_cosine(window, living)]
    values[:, np.arange(uavs), np.arange(uavs)] = 0.0
    return np.concatenate([values, _standardise_rows(values)]).transpose(1, 2, 0)


def _compute_flight_statistics(velocity: Singles, seen: Mask) -> Iterator[Singles]:
    steps = len(velocity)
    linear = centre_columns(velocity, seen)
    quadratic = centre_columns(_make_quadratic_features(velocity), seen)
    # The products of each axis of a velocity with each axis of the previous velocity.
    products = (velocity[1:, :, :, None] * velocity[:-1, :, None, :]).reshape(steps - 1, velocity.shape[1], 9)
    products = centre_columns(products, seen[1:] & seen[:-1])
    own = 2 if steps >= _LONG else 1
    surprise, late = compute_innovations(linear, own), seen[own:]
    for target, first, second, third, there in (
        (linear, linear, quadratic, products, seen),
        (surprise, surprise, compute_innovations(quadratic, 1), compute_innovations(products, 1), late),
    ):
        unit = scale_to_unit(target)
        yield _explain_at_lag(first, unit, 0)
        single = [_explain_at_lag(features, unit, lag) for lag in range(1, LAGS + 1) for features in (first, second)]
        single += [_explain_at_lag(third, unit, lag) for lag in range(1, _PRODUCT_LAGS + 1)]
        yield from single
        yield np.max(single, axis=0)
        length = np.sqrt((target**2).sum(axis=2, keepdims=True))
        direction = (target / np.where(length > 1e-9, length, np.inf)).astype(np.float32)
        for lag in range(LAGS + 1):
            yield _compute_mean_cosine(direction, there, lag)
    yield from _explain_jointly(linear, quadratic, surprise)


def _scale_velocity(velocity: Singles, seen: Mask) -> Singles:
    """Divide ``velocity`` ``(T, n, 3)`` by the swarm's root mean square speed; 0 where unseen."""
    squared = (velocity**2).sum(axis=2) * seen
    speed = np.sqrt(squared.sum(dtype=np.float64) / max(int(seen.sum()), 1))
    return np.asarray(velocity * seen[..., None] / (speed if speed > 0 else np.inf), np.float32)


def _make_quadratic_features(velocity: Singles) -> Singles:
    """``(T, n, 6)``: the products of the axes, weighted so that a rotation of the axes rotates this vector."""
    x, y, z = np.moveaxis(velocity, 2, 0)
    mixed = np.float32(np.sqrt(2.0))
    return np.stack([x * x, y * y, z * z, mixed * x * y, mixed * y * z, mixed * z * x], axis=2)


def _explain_shares(features: Singles, targets: list[Singles]) -> list[Singles]:
    """Shares of ``targets`` ``(rows, n, 3)`` that ``features`` ``(n, rows, p)`` explain, corrected for chance."""
    uavs, rows, count = features.shape
    if rows < _ROWS_PER_FEATURE * count:
        return [np.zeros((uavs, uavs), np.float32) for _ in targets]
    chance = count / rows
    return [np.asarray((share - chance) / (1.0 - chance), np.float32) for share in explain_pairs(features, targets)[0]]


def _explain_at_lag(features: Singles, target: Singles, lag: int) -> Singles:
    """Share of ``target``, ``lag`` steps later, that ``features`` explain; both series end at the same time."""
    steps = min(len(features), len(target))
    features, target = features[len(features) - steps :], target[len(target) - steps :]
    return _explain_shares(features[: steps - lag].transpose(1, 0, 2), [target[lag:]])[0]


def _compute_mean_cosine(direction: Singles, seen: Mask, lag: int) -> Singles:
    """Mean cosine between UAV i's direction and UAV j's, ``lag`` steps earlier; ``direction`` is 0 where unseen."""
    steps, uavs = seen.shape
    if steps - lag < 2:
        return np.zeros((uavs, uavs), np.float32)
    times = seen[lag:].T.astype(np.float32) @ seen[: steps - lag].astype(np.float32)
    return np.asarray(correlate_at_lag(direction, direction, lag) / np.maximum(times, 1.0), np.float32)


def _explain_jointly(linear: Singles, quadratic: Singles, surprise: Singles) -> Iterator[Singles]:
    """Yield the shares by several lags together: of v_i and of e_i, each also shifted by half a window."""
    lags = max(1, count_lags(len(linear), _JOINT_LAGS, _LINEAR + _QUADRATIC, _ROWS_PER_FEATURE))
    past = stack_past(np.concatenate([linear, quadratic], axis=2), lags)
    past = past.reshape(*past.shape[:2], lags * (_LINEAR + _QUADRATIC))
    for target in (linear, surprise):
        rows = min(past.shape[1], len(target))
        recent = target[len(target) - rows :]
        yield from _explain_shares(past[:, past.shape[1] - rows :], [recent, shift_in_time(recent)])


def _compute_direction_cosine(window: Window, living: NDArray[np.intp]) -> Singles:
    """Cosine between i's mean velocity and the direction from i to j, times |i's mean velocity| / i's rms speed."""
    seen = window.seen[:, living].astype(np.float32)[..., None]
    place = (window.position[:, living] * seen).sum(axis=0) / np.maximum(seen.sum(axis=0), 1.0)
    moving = window.velocity_seen[:, living].astype(np.float32)[..., None]
    times = np.maximum(moving.sum(axis=0), 1.0)
    mean = (window.velocity[:, living] * moving).sum(axis=0) / times
    speed = np.sqrt((window.velocity[:, living] ** 2 * moving).sum(axis=(0, 2)) / times[:, 0])
    straight = mean / np.where(speed > 1e-9, speed, np.inf)[:, None]
    gap = place[None] - place[:, None]
    distance = np.sqrt((gap**2).sum(axis=2, keepdims=True))
    direction = gap / np.where(distance > 1e-9, distance, np.inf)
    return np.asarray((direction * straight[:, None]).sum(axis=2), np.float32)


def _standardise_rows(values: Singles) -> Singles:
    """Standardise ``values`` ``(K, n, n)`` within each row, without the diagonal."""
    uavs = values.shape[1]
    others = max(uavs - 1, 1)
    mean = values.sum(axis=2, keepdims=True) / others  # the diagonal is 0 and adds nothing
    apart = values - mean
    apart[:, np.arange(uavs), np.arange(uavs)] = 0.0
    spread = np.sqrt((apart**2).sum(axis=2, keepdims=True) / others)
    scaled = np.clip(apart / np.where(spread > 1e-6, spread, np.inf), -_SPREADS, _SPREADS)
    return np.asarray(scaled, np.float32)
