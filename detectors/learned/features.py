"""What the network looks at: statistics of every ordered pair of UAVs, all from matrix products.

Entry (i, j) tells how far UAV j's past tells UAV i's present. Every statistic is a share of explained variance or a
cosine, so that nothing changes when the swarm is turned, moved or measured in other units, and the values of the pairs
move with the UAVs when these are numbered otherwise.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from detectors.lagged.selection import centre_columns
from usnet_env.window import Window

__all__ = ["LAGS", "PAIR_FEATURES", "pair_features"]

Floats = NDArray[np.float32]

LAGS = 5  # single lags that are looked at; f1 to f7 reach back 4 steps
_JOINT_LAGS = 4  # of the regressions on several lags at once
_ROWS_PER_FEATURE = 1.5  # of a regression, as detectors.lagged.regression has measured
_RIDGE = 1e-3
_LONG = 20  # velocities from which on a UAV's last two tell its own next one; its last alone below
_SPREADS = 10.0  # a row's standardised values are cut at this many spreads

_PRODUCT_LAGS = 3
_LINEAR, _QUADRATIC = 3, 6
_STATISTICS = 2 * (2 * LAGS + 1 + _PRODUCT_LAGS + 1) + 2 * (LAGS + 1) + 4 + 1
#: values of a pair: each statistic as it is, and against all others in its row
PAIR_FEATURES = 2 * _STATISTICS


def pair_features(window: Window, living: NDArray[np.intp]) -> Floats:
    """The statistics of all pairs of living UAVs.

    For the velocities v and, again, for their innovations e (what a UAV's own last velocities don't tell): the share of
    UAV i's that a linear map, and a quadratic one, of UAV j's velocity explains, for lags 1 to ``LAGS``, and a map of
    the products of two successive velocities for lags 1 to 3; the largest of these; the linear one for lag 0; the
    cosine of both, averaged over time, for lags 0 to ``LAGS``. Then the share that a ridge on up to four lags of v_j,
    linear and quadratic, explains of v_i and of e_i, and the same with UAV i half a window late, which is what chance
    gives; last, the cosine of i's mean velocity and the direction to j. Samples that are missing count for nothing.

    Args:
        window: N UAVs, T_ob velocities.
        living: ``(n,)`` indices of those to look at.

    Returns:
        ``(n, n, PAIR_FEATURES)`` float32; the diagonal is 0, and so is what a window is too short for.
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
    """``velocity`` ``(T, n, 3)`` in units of the swarm's own root mean square speed; 0 where unseen."""
    squared = (velocity**2).sum(axis=2) * seen
    speed = np.sqrt(squared.sum(dtype=np.float64) / max(int(seen.sum()), 1))
    return np.asarray(velocity * seen[..., None] / (speed if speed > 0 else np.inf), np.float32)


def _centre_columns(values: Floats, seen: NDArray[np.bool_]) -> Floats:
    return centre_columns(values, seen).astype(np.float32)  # type: ignore[arg-type]


def _make_quadratic_features(velocity: Floats) -> Floats:
    """``(T, n, 6)``: the products of the axes, weighted so that turning the axes turns this vector."""
    x, y, z = np.moveaxis(velocity, 2, 0)
    mixed = np.float32(np.sqrt(2.0))
    return np.stack([x * x, y * y, z * z, mixed * x * y, mixed * y * z, mixed * z * x], axis=2)


def _make_product_features(velocity: Floats) -> Floats:
    """``(T - 1, n, 9)``: every axis of a velocity times every axis of the one before."""
    mixed = velocity[1:, :, :, None] * velocity[:-1, :, None, :]
    return mixed.reshape(len(mixed), velocity.shape[1], 9)


def _whiten_features(features: Floats) -> Floats:
    """Q of the shape of ``features`` ``(n, rows, p)``: |Qᵀ y|² is what a ridge on them explains of y."""
    gram = features.transpose(0, 2, 1) @ features
    size = np.trace(gram, axis1=1, axis2=2) / gram.shape[1]
    flat = np.where(size > 1e-9, _RIDGE * size, 1.0)  # a UAV that never moves explains nothing, and divides nothing
    gram[:, np.arange(gram.shape[1]), np.arange(gram.shape[1])] += flat[:, None]
    root = np.linalg.inv(np.linalg.cholesky(gram))
    return np.asarray(features @ root.transpose(0, 2, 1), np.float32)


def _compute_innovation(values: Floats, lags: int) -> Floats:
    """``(T - lags, n, d)``: what a ridge on the own last ``lags`` values leaves of ``values`` ``(T, n, d)``."""
    steps = len(values)
    past = np.concatenate([values[lags - lag : steps - lag] for lag in range(1, lags + 1)], axis=2)
    white = _whiten_features(past.transpose(1, 0, 2))
    target = values[lags:].transpose(1, 0, 2)
    left = target - white @ (white.transpose(0, 2, 1) @ target)
    return left.transpose(1, 0, 2)


def _normalise_target(target: Floats) -> Floats:
    """``target`` ``(T, n, 3)`` with a squared sum of 1 for each UAV; 0 for one that never moves."""
    total = (target**2).sum(axis=(0, 2))
    return np.asarray(target / np.sqrt(np.where(total > 1e-9, total, np.inf))[:, None], np.float32)


def _explain_share(features: Floats, target: Floats) -> Floats:
    """Share of ``target`` ``(rows, n, 3)`` that ``features`` ``(rows, n, p)`` explain, less what chance would."""
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
    """What ``features`` explain of ``target`` ``lag`` steps later; both end at the same time, one may begin earlier."""
    steps = min(len(features), len(target))
    features, target = features[len(features) - steps :], target[len(target) - steps :]
    return _explain_share(features[: steps - lag], target[lag:])


def _compute_mean_cosine(direction: Floats, seen: NDArray[np.bool_], lag: int) -> Floats:
    """Mean cosine of UAV i's direction and UAV j's ``lag`` steps before; ``direction`` is 0 where unseen."""
    steps, uavs = seen.shape
    if steps - lag < 2:
        return np.zeros((uavs, uavs), np.float32)
    later = direction[lag:].transpose(1, 0, 2).reshape(uavs, -1)
    before = direction[: steps - lag].transpose(1, 0, 2).reshape(uavs, -1)
    times = seen[lag:].T.astype(np.float32) @ seen[: steps - lag].astype(np.float32)
    return np.asarray((later @ before.T) / np.maximum(times, 1.0), np.float32)


def _explain_jointly(linear: Floats, quadratic: Floats, surprise: Floats) -> Iterator[Floats]:
    """The regressions on several lags at once: of v_i and e_i, and of both half a window late."""
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
    """Cosine of UAV i's mean velocity and the direction from i's mean position to j's, times i's straightness."""
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
    """How many spreads each of ``values`` ``(K, n, n)`` lies above the others of its row, the diagonal left out."""
    uavs = values.shape[1]
    others = np.float32(max(uavs - 1, 1))
    mean = values.sum(axis=2, keepdims=True) / others  # the diagonal is 0 and adds nothing
    spread = np.sqrt(np.maximum((values**2).sum(axis=2, keepdims=True) / others - mean**2, 0.0))
    scaled = np.clip((values - mean) / np.where(spread > 1e-6, spread, np.inf), -_SPREADS, _SPREADS)
    scaled[:, np.arange(uavs), np.arange(uavs)] = 0.0
    return np.asarray(scaled, np.float32)
