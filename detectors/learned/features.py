"""Inputs of the network: statistics of every ordered pair of UAVs, computed by matrix products.

Entry (i, j) measures how well UAV j's past predicts UAV i's velocity. Each statistic is a share of explained variance
or a cosine; so it is invariant under rotation, translation and scaling of the swarm. Permuting the UAVs permutes the
entries.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from detectors.lagged.selection import centre_columns
from usnet_env.window import Window

__all__ = ["LAGS", "PAIR_FEATURES", "pair_features"]

Floats = NDArray[np.float32]

LAGS = 5  # number of single lags; f1 to f7 use at most 4 past steps
_JOINT_LAGS = 4  # lags of the regressions on several lags together
_ROWS_PER_FEATURE = 1.5  # least samples per feature of a regression, as in detectors.lagged.regression
_RIDGE = 1e-3
_LONG = 20  # with at least as many velocities, the innovation is taken against two own past velocities, otherwise one
_SPREADS = 10.0  # standardised values are clipped to this many standard deviations

_PRODUCT_LAGS = 3
_LINEAR, _QUADRATIC = 3, 6
_STATISTICS = 2 * (2 * LAGS + 1 + _PRODUCT_LAGS + 1) + 2 * (LAGS + 1) + 4 + 1
#: Number of values per pair: each statistic, and its standardised value within its row.
PAIR_FEATURES = 2 * _STATISTICS


def pair_features(window: Window, living: NDArray[np.intp]) -> Floats:
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

    Args:
        window: a window of N UAVs with T_ob velocities.
        living: ``(n,)`` indices of the UAVs to use.

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


def _compute_flight_statistics(velocity: Floats, seen: NDArray[np.bool_]) -> Iterator[Floats]:
    steps = len(velocity)
    linear = _centre_columns(velocity, seen)
    quadratic = _centre_columns(_make_quadratic_features(velocity), seen)
    products = _centre_columns(_make_product_features(velocity), seen[1:] & seen[:-1])
    own = 2 if steps >= _LONG else 1
    surprise, late = _compute_innovation(linear, own), seen[own:]
    for target, first, second, third, there in (
        (linear, linear, quadratic, products, seen),
        (surprise, surprise, _compute_innovation(quadratic, 1), _compute_innovation(products, 1), late),
    ):
        unit = _normalise_target(target)
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


def _scale_velocity(velocity: Floats, seen: NDArray[np.bool_]) -> Floats:
    """Divide ``velocity`` ``(T, n, 3)`` by the swarm's root mean square speed; 0 where unseen."""
    squared = (velocity**2).sum(axis=2) * seen
    speed = np.sqrt(squared.sum(dtype=np.float64) / max(int(seen.sum()), 1))
    return np.asarray(velocity * seen[..., None] / (speed if speed > 0 else np.inf), np.float32)


def _centre_columns(values: Floats, seen: NDArray[np.bool_]) -> Floats:
    return centre_columns(values, seen).astype(np.float32)  # type: ignore[arg-type]


def _make_quadratic_features(velocity: Floats) -> Floats:
    """``(T, n, 6)``: the products of the axes, weighted so that a rotation of the axes rotates this vector."""
    x, y, z = np.moveaxis(velocity, 2, 0)
    mixed = np.float32(np.sqrt(2.0))
    return np.stack([x * x, y * y, z * z, mixed * x * y, mixed * y * z, mixed * z * x], axis=2)


def _make_product_features(velocity: Floats) -> Floats:
    """``(T - 1, n, 9)``: the products of each axis of a velocity with each axis of the previous velocity."""
    mixed = velocity[1:, :, :, None] * velocity[:-1, :, None, :]
    return mixed.reshape(len(mixed), velocity.shape[1], 9)


def _whiten_features(features: Floats) -> Floats:
    """Q of the shape of ``features`` ``(n, rows, p)`` such that a ridge on them explains |Qᵀ y|² of y."""
    gram = features.transpose(0, 2, 1) @ features
    size = np.trace(gram, axis1=1, axis2=2) / gram.shape[1]
    flat = np.where(size > 1e-9, _RIDGE * size, 1.0)  # avoids a division by 0 for a UAV that never moves
    gram[:, np.arange(gram.shape[1]), np.arange(gram.shape[1])] += flat[:, None]
    root = np.linalg.inv(np.linalg.cholesky(gram))
    return np.asarray(features @ root.transpose(0, 2, 1), np.float32)


def _compute_innovation(values: Floats, lags: int) -> Floats:
    """``(T - lags, n, d)``: residuals of a ridge of ``values`` ``(T, n, d)`` on their last ``lags`` values."""
    steps = len(values)
    past = np.concatenate([values[lags - lag : steps - lag] for lag in range(1, lags + 1)], axis=2)
    white = _whiten_features(past.transpose(1, 0, 2))
    target = values[lags:].transpose(1, 0, 2)
    left = target - white @ (white.transpose(0, 2, 1) @ target)
    return left.transpose(1, 0, 2)


def _normalise_target(target: Floats) -> Floats:
    """Scale ``target`` ``(T, n, 3)`` to a squared sum of 1 per UAV; 0 for a UAV that never moves."""
    total = (target**2).sum(axis=(0, 2))
    return np.asarray(target / np.sqrt(np.where(total > 1e-9, total, np.inf))[:, None], np.float32)


def _explain_share(features: Floats, target: Floats) -> Floats:
    """Share of ``target`` ``(rows, n, 3)`` that ``features`` ``(rows, n, p)`` explain, corrected for chance."""
    rows, uavs, count = features.shape
    if rows < _ROWS_PER_FEATURE * count:
        return np.zeros((uavs, uavs), np.float32)
    total = np.maximum((target**2).sum(axis=(0, 2)), 1e-9)
    white = _whiten_features(features.transpose(1, 0, 2))
    product = white.transpose(0, 2, 1).reshape(uavs * count, rows) @ target.transpose(0, 2, 1).reshape(rows, -1)
    share = (product**2).reshape(uavs, count * 3, uavs).sum(axis=1).T / total[:, None]
    chance = count / rows
    return np.asarray((share - chance) / (1.0 - chance), np.float32)


def _explain_at_lag(features: Floats, target: Floats, lag: int) -> Floats:
    """Share of ``target``, ``lag`` steps later, that ``features`` explain; both series end at the same time."""
    steps = min(len(features), len(target))
    features, target = features[len(features) - steps :], target[len(target) - steps :]
    return _explain_share(features[: steps - lag], target[lag:])


def _compute_mean_cosine(direction: Floats, seen: NDArray[np.bool_], lag: int) -> Floats:
    """Mean cosine between UAV i's direction and UAV j's, ``lag`` steps earlier; ``direction`` is 0 where unseen."""
    steps, uavs = seen.shape
    if steps - lag < 2:
        return np.zeros((uavs, uavs), np.float32)
    later = direction[lag:].transpose(1, 0, 2).reshape(uavs, -1)
    before = direction[: steps - lag].transpose(1, 0, 2).reshape(uavs, -1)
    times = seen[lag:].T.astype(np.float32) @ seen[: steps - lag].astype(np.float32)
    return np.asarray((later @ before.T) / np.maximum(times, 1.0), np.float32)


def _explain_jointly(linear: Floats, quadratic: Floats, surprise: Floats) -> Iterator[Floats]:
    """Yield the shares by several lags together: of v_i and of e_i, each also shifted by half a window."""
    steps = len(linear)
    width = _LINEAR + _QUADRATIC
    lags = _JOINT_LAGS
    while lags > 1 and steps - lags < _ROWS_PER_FEATURE * width * lags:
        lags -= 1
    both = np.concatenate([linear, quadratic], axis=2)
    past = np.concatenate([both[lags - lag : steps - lag] for lag in range(1, lags + 1)], axis=2)
    for target in (linear, surprise):
        rows = min(len(past), len(target))
        recent = target[len(target) - rows :]
        for shift in (0, rows // 2):
            yield _explain_share(past[len(past) - rows :], np.roll(recent, shift, axis=0))


def _compute_direction_cosine(window: Window, living: NDArray[np.intp]) -> Floats:
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


def _standardise_rows(values: Floats) -> Floats:
    """Standardise ``values`` ``(K, n, n)`` within each row, without the diagonal."""
    uavs = values.shape[1]
    others = np.float32(max(uavs - 1, 1))
    mean = values.sum(axis=2, keepdims=True) / others  # the diagonal is 0 and adds nothing
    spread = np.sqrt(np.maximum((values**2).sum(axis=2, keepdims=True) / others - mean**2, 0.0))
    scaled = np.clip((values - mean) / np.where(spread > 1e-6, spread, np.inf), -_SPREADS, _SPREADS)
    scaled[:, np.arange(uavs), np.arange(uavs)] = 0.0
    return np.asarray(scaled, np.float32)
