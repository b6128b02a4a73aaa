"""Worlds of UAVs that keep places in the frame of a course: groups with a leader, flocks without one, and strangers.

Each UAV also sways, shakes and has a gait of its own, which tells nothing of others: who is in front of a group on its
mean course, and whose turns come first, is all that shows its leader.
"""

import numpy as np

from detectors.reader.prior.families import draw_log, draw_whole
from detectors.reader.prior.worlds.stage import Flight, Stage, keep_noise
from usnet_env.arrays import Floats, Indices

_LONGEST = 40  # steps that a UAV may be later than its leader


def _draw_headings(rng: np.random.Generator, stage: Stage, paths: int, stream: bool) -> Floats:
    """Headings ``(B, 1, m)`` at the begin: of a stream, of two that meet, or any."""
    shape = stage.windows, 1, paths
    if not stream and rng.random() < 0.4:
        return rng.uniform(0.0, 2.0 * np.pi, shape)
    ahead = rng.uniform(0.0, 2.0 * np.pi, (stage.windows, 1, 1))
    spread = draw_log(rng, 0.02, 0.5) * rng.standard_normal(shape)
    return np.asarray(ahead + spread + np.pi * rng.integers(2, size=shape) * rng.integers(2))


def _draw_paths(rng: np.random.Generator, stage: Stage, paths: int, stream: bool = False) -> tuple[Floats, Floats]:
    """Positions ``(B, S + T + 1, m, 3)`` and velocities of m walkers on calm ways, S the longest delay."""
    shape, per_path = (stage.windows, stage.steps + _LONGEST + 1, paths), (stage.windows, 1, paths)
    calm, size = rng.uniform(0.7, 0.99, stage.windows), draw_log(rng, 0.0005, 0.1, stage.windows, 1, 1)
    heading = np.cumsum(size * keep_noise(rng.standard_normal(shape), calm), axis=1)
    heading += _draw_headings(rng, stage, paths, stream)
    variation = keep_noise(rng.standard_normal(shape), rng.uniform(0.8, 0.99, stage.windows))
    pace = np.exp(rng.uniform(0.0, 0.3) * variation + draw_log(rng, 0.01, 0.3) * rng.standard_normal(per_path))
    climb = np.broadcast_to(0.2 * stage.axes[2] * rng.standard_normal(per_path), shape)
    velocity = pace[..., None] * np.stack([np.cos(heading), np.sin(heading), climb], axis=-1)
    position, meeting = np.cumsum(velocity, axis=1), int(rng.integers(_LONGEST, shape[1]))
    middle = draw_log(rng, 1.0, 60.0, stage.windows, 1, 1) * stage.draw_normals(rng, paths)
    return position - position[:, meeting : meeting + 1] + middle[:, None], velocity


def _orient(slot: Floats, course: Floats) -> Floats:
    """Offsets ``(..., n, 3)`` of places along, across and above a course, of any length."""
    course = course / (np.linalg.norm(course, axis=-1, keepdims=True) + 1e-9)
    side, above = course[..., [1, 0, 2]] * [-1.0, 1.0, 0.0], np.array([0.0, 0.0, 1.0])
    return np.asarray(slot[..., :1] * course + slot[..., 1:2] * side + slot[..., 2:] * above)


def _keep_places(
    rng: np.random.Generator, stage: Stage, path: Floats, velocity: Floats, column: Indices, slot: Floats, late: Indices
) -> Floats:
    """Positions ``(B, T + 1, n, 3)`` of UAVs that keep a ``slot (B, n, 3)`` in the frame of the late course of a path.

    UAV i goes by path ``column[i]`` as it was ``late (B, n)`` steps before, but no farther behind for that.
    """
    width, window = int(rng.choice([1, 5, 9, 15])), np.arange(stage.windows)[:, None, None]
    mean = np.cumsum(np.pad(velocity, ((0, 0), (width, 0), (0, 0), (0, 0)), mode="edge"), axis=1)
    course = mean[:, width:] - mean[:, :-width]
    past = np.arange(-stage.steps - 1, 0)[:, None] - late[:, None]
    slot = slot.copy()
    slot[..., 0] += late * np.linalg.norm(velocity, axis=-1).mean(axis=1)[:, column]
    return path[window, past, column] + _orient(slot[:, None], course[window, past, column])


def _copy_courses(stage: Stage, path: Floats, column: Indices, slot: Floats, late: Indices) -> Floats:
    """Positions ``(B, T + 1, n, 3)`` of UAVs that fly parallel to a path, late; their formation doesn't turn."""
    window, last, middle = np.arange(stage.windows)[:, None, None], -stage.steps - 1, stage.steps // 2
    position = path[window, np.arange(last, 0)[:, None] - late[:, None], column]
    position -= position[:, middle : middle + 1]
    start = path[:, last + middle, column] + _orient(slot, (path[:, -1] - path[:, last])[:, column])
    return np.asarray(position + start[:, None])


def _draw_sway(rng: np.random.Generator, stage: Stage, uavs: int, memory: Floats) -> Floats:
    """Smooth or rough offsets ``(B, T + 1, n, 3)`` of size about 1 that last for ``memory (B,)`` steps."""
    keep = 1.0 - 1.0 / memory
    sway = keep_noise(stage.draw_normals(rng, stage.steps + 1, uavs), keep)
    if rng.random() < 0.5:
        sway = keep_noise(sway, keep) / np.sqrt((1.0 + keep**2) / (1.0 - keep**2)).reshape(-1, 1, 1, 1)
    return sway


def _draw_own_motion(rng: np.random.Generator, stage: Stage, uavs: int, longest: float = 60.0) -> Floats:
    """Offsets ``(B, T + 1, n, 3)`` of UAVs: a sway with a memory up to ``longest`` steps, a fast shake, and a gait."""
    shape, memory = (stage.windows, 1, 1, 1), draw_log(rng, 5.0, longest, stage.windows)
    scale = np.exp(rng.uniform(0.0, 0.5) * rng.standard_normal((stage.windows, 1, uavs, 1)))
    slow = np.sqrt(memory / 2.0).reshape(shape) * _draw_sway(rng, stage, uavs, memory)
    fast = keep_noise(stage.draw_normals(rng, stage.steps + 1, uavs), rng.uniform(0.0, 0.7, stage.windows))
    beat = rng.uniform(3.0, 12.0, (stage.windows, 1, uavs, 1)), rng.random((stage.windows, 1, uavs, 1))
    gait = np.sin(2.0 * np.pi * (np.arange(stage.steps + 1.0)[:, None, None] / beat[0] + beat[1]))
    gait = gait * rng.integers(2) * draw_log(rng, 0.02, 0.4, *shape) * stage.draw_normals(rng, 1, 1)
    return scale * (draw_log(rng, 0.06, 0.9, *shape) * slow + draw_log(rng, 0.005, 0.5, *shape) * fast) + gait


def _draw_slots(rng: np.random.Generator, stage: Stage, uavs: int, least: float, most: float) -> Floats:
    """Places ``(B, n, 3)`` along, across and above a course: ``least`` to ``most`` steps wide, mostly side by side."""
    wide = draw_log(rng, least, most, stage.windows, 1, 1)
    shares = np.array([rng.uniform(0.1, 1.0), rng.uniform(0.3, 2.0), rng.uniform(0.0, 1.0)])
    return np.asarray(wide * shares * [1.0, 1.0, stage.axes[2]] * rng.standard_normal((stage.windows, uavs, 3)))


def _draw_companies(rng: np.random.Generator, uavs: int) -> Indices:
    """The leader ``(n,)`` of each UAV in groups of 2 to about 8, leaders first, and of lone ones, last."""
    lone = int(rng.integers(uavs - 1)) if rng.random() < 0.4 else 0
    grouped = uavs - lone
    groups = draw_whole(rng, -(-grouped // 8), grouped // 2)
    heads = np.arange(groups)
    return np.concatenate([heads, heads, rng.integers(groups, size=grouped - 2 * groups), grouped + np.arange(lone)])


def draw_formation(rng: np.random.Generator, stage: Stage) -> Flight:
    """Groups that keep a formation: the others hold their places to one, who is in front in most, by little.

    They turn with it, go to the same places, or copy its course some steps late.
    """
    leader, index = _draw_companies(rng, stage.uavs), np.arange(stage.uavs)
    column = np.unique(leader, return_inverse=True)[1]
    path, velocity = _draw_paths(rng, stage, int(column.max()) + 1)
    slot = _draw_slots(rng, stage, stage.uavs, 0.5, 16.0)
    is_same_group = column[:, None] == column
    top = np.where(is_same_group & (index != leader), slot[:, None, :, 0], -np.inf).max(axis=2)
    gap = np.abs(draw_log(rng, 0.2, 1.5) * slot[..., 1].std(axis=1, keepdims=True) * rng.standard_normal(top.shape))
    is_front = np.isfinite(top) & (rng.random(top.shape) < 0.85)
    slot[..., 0] = np.where(is_front & (index == leader), np.where(is_front, top, 0.0) + gap, slot[..., 0])
    slot -= slot[:, leader]
    slot[..., 0] = np.clip(slot[..., 0], -_LONGEST, _LONGEST)
    kind, late = rng.choice(["turn", "follow", "copy"], p=[0.4, 0.4, 0.2]), np.zeros(top.shape, np.int64)
    if kind == "copy":
        late = np.where(index == leader, 0, stage.draw_delays(rng, 12))
        position = _copy_courses(stage, path, column, slot, late)
    else:
        if kind == "follow":
            late = np.maximum(np.rint(-slot[..., 0]), 0).astype(np.int64)
        position = _keep_places(rng, stage, path, velocity, column, slot, late)
    return Flight(position + _draw_own_motion(rng, stage, stage.uavs), leader, np.where(late > 0, late, np.nan))


def draw_strangers(rng: np.random.Generator, stage: Stage) -> Flight:
    """UAVs on like courses at like speeds, in one stream or in two that meet, without a leader."""
    path, _ = _draw_paths(rng, stage, stage.uavs, stream=True)
    return Flight(path[:, _LONGEST:] + _draw_own_motion(rng, stage, stage.uavs), np.arange(stage.uavs))


def draw_unled(rng: np.random.Generator, stage: Stage) -> Flight:
    """A flock without a leader that keeps a formation around a common centre, in the frame of its course or not."""
    path, velocity = _draw_paths(rng, stage, 1)
    slot, column = _draw_slots(rng, stage, stage.uavs, 0.5, 20.0), np.zeros(stage.uavs, np.int64)
    late = np.zeros(slot.shape[:2], np.int64)
    if rng.random() < 0.5:
        position = _keep_places(rng, stage, path, velocity, column, slot, late)
    else:
        position = _copy_courses(stage, path, column, slot, late)
    position += _draw_own_motion(rng, stage, stage.uavs, 200.0)
    return Flight(position, np.arange(stage.uavs), link=np.nan)


def draw_driven(rng: np.random.Generator, stage: Stage) -> Flight:
    """A herd without a leader that a driver behind it turns: those next to the driver first, those in front last.

    The driver goes from side to side; it is unseen in half of the draws.
    """
    path, _ = _draw_paths(rng, stage, 1)
    slot, column = _draw_slots(rng, stage, stage.uavs, 0.5, 20.0), np.zeros(stage.uavs, np.int64)
    order = slot[..., 0] - slot[..., 0].min(axis=1, keepdims=True)
    wave = draw_log(rng, 0.05, 2.0, stage.windows, 1) * order + rng.uniform(0.0, 2.0, order.shape)
    late = np.clip(np.rint(wave), 0, _LONGEST).astype(np.int64)
    extent = slot.std(axis=(1, 2))[:, None] + 1.0
    slot[:, 0, 0] = slot[..., 0].min(axis=1) - extent[:, 0] * rng.uniform(0.5, 3.0, stage.windows)
    late[:, 0] = 0
    position = _copy_courses(stage, path, column, slot, late)
    position += _draw_own_motion(rng, stage, stage.uavs, 200.0)
    zigzag = _draw_sway(rng, stage, 1, rng.uniform(20.0, 100.0, stage.windows))[:, :, 0]
    position[:, :, 0] += extent[..., None] * rng.uniform(0.2, 2.0) * zigzag
    shown = position[:, :, int(rng.integers(2)) :]
    return Flight(shown, np.arange(shown.shape[2]), link=np.nan)
