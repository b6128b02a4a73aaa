"""The compiled inner loops of the simulator: velocities of heads, kinematics, steps of a flight, and the re-merge.

The same loop over episodes simulates one swarm and a batch, so episode b of a batch equals the single swarm bit for
bit. Position ``(B, L + S + 1, N, 3)`` and velocity ``(B, L + S, N, 3)`` begin with L steps of the past; the next S
steps are simulated by the call. All arrays except the mobility state, and all constants, are float32.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from usnet_env.compiling import compiled

DESTROYED, FREE, FOLLOWS = 0, 1, 2  # how a UAV moves in a window; a free UAV (head or decoy) follows no UAV
IID, GAUSS_MARKOV, SMOOTH_TURN, WAYPOINT, LOCAL_WAYPOINT, STRAIGHT = range(6)  # the mobilities that are compiled
NOT_COMPILED = -1  # the number of another mobility
UNIT, VARIED_SPEED, LAGGED, LIMITED, LAYERED = range(5)  # the kinematics that are compiled
MOBILITY_STATE = 8  # number of float64 values in the mobility state of a UAV

_ONE = np.float32(1.0)
_ZERO = np.float32(0.0)
_TINY = np.float32(1e-12)


@compiled(inner=True, error_model="numpy")
def norm(x, y, z):
    """The vector (x, y, z) scaled to length 1."""
    size = _ONE / np.sqrt(x * x + y * y + z * z + _TINY)
    return x * size, y * size, z * size


@compiled(inner=True, error_model="numpy")
def gap(position, b, t, i, j):
    """The way from UAV j to UAV i at instant t."""
    place, other = position[b, t, i], position[b, t, j]
    return place[0] - other[0], place[1] - other[1], place[2] - other[2]


@compiled(inner=True, error_model="numpy")
def finish_step(b, s, t, i, x, y, z, noise_scale, noise, velocity):
    """Write norm((x, y, z) + noise) as the velocity of UAV i in step t; ``noise`` is that of swarm b."""
    velocity[b, t, i, 0], velocity[b, t, i, 1], velocity[b, t, i, 2] = norm(
        x + noise_scale * noise[s, i, 0], y + noise_scale * noise[s, i, 1], z + noise_scale * noise[s, i, 2]
    )


@compiled(inner=True)
def _uniform(z):
    """Map the standard normal number z to a uniform number in (0, 1) by the normal distribution function."""
    return min(max(0.5 * math.erfc(-z / math.sqrt(2.0)), 1e-12), 1.0 - 1e-12)


@compiled(inner=True, _nrt=False, error_model="numpy")
def _turn_towards(state, x, y, z, limit):
    """Turn the unit direction ``state[0:3]`` towards (x, y, z) by at most ``limit`` radians."""
    length = math.sqrt(x * x + y * y + z * z)
    if length < 1e-12:
        return
    x, y, z = x / length, y / length, z / length
    cosine = min(max(x * state[0] + y * state[1] + z * state[2], -1.0), 1.0)
    angle = math.acos(cosine)
    if angle <= limit:
        state[0], state[1], state[2] = x, y, z
        return
    # The part of the target that is perpendicular to the direction spans the plane of the turn.
    px, py, pz = x - cosine * state[0], y - cosine * state[1], z - cosine * state[2]
    size = math.sqrt(px * px + py * py + pz * pz)
    if size < 1e-9:  # the target is exactly behind: take any plane that contains the direction
        px, py, pz, size = -state[1], state[0], 0.0, math.hypot(state[0], state[1])
        if size < 1e-9:
            px, py, pz, size = 1.0, 0.0, 0.0, 1.0
    c, s = math.cos(limit), math.sin(limit) / size
    state[0], state[1], state[2] = c * state[0] + s * px, c * state[1] + s * py, c * state[2] + s * pz


@compiled(inner=True, _nrt=False, error_model="numpy")
def _draw_turn(state, z, rate, max_angle):
    """Draw a turn: its axis (perpendicular to the direction), its angle per step and its duration in steps."""
    x, y, w = float(z[0]), float(z[1]), float(z[2])
    along = x * state[0] + y * state[1] + w * state[2]
    x, y, w = x - along * state[0], y - along * state[1], w - along * state[2]
    size = math.sqrt(x * x + y * y + w * w) + 1e-12
    state[3], state[4], state[5] = x / size, y / size, w / size
    # The angle has an exponential distribution truncated at `max_angle`, drawn by its inverse distribution function.
    mean = max_angle / 3.0
    state[6] = -mean * math.log(1.0 - _uniform(z[3]) * (1.0 - math.exp(-max_angle / mean)))
    state[7] = -math.log(_uniform(z[4])) / rate


@compiled(inner=True, _nrt=False, error_model="numpy")
def _step_mobility(code, state, z, px, py, pz, numbers):
    """One step of one free UAV at (px, py, pz): update ``state`` and return the direction of flight, float32."""
    x, y, w = 0.0, 0.0, 0.0
    if code == IID:
        x, y, w = np.float64(z[0]), np.float64(z[1]), np.float64(z[2])
    elif code == GAUSS_MARKOV:  # state: azimuth, pitch, and their means
        keep = numbers[0]  # lag-one autocorrelation
        push = math.sqrt(1.0 - keep * keep)
        state[0] = keep * state[0] + (1.0 - keep) * state[2] + push * math.sqrt(numbers[1]) * z[0]
        state[1] = keep * state[1] + (1.0 - keep) * state[3] + push * math.sqrt(numbers[2]) * z[1]
        x = math.cos(state[0]) * math.cos(state[1])
        y = math.sin(state[0]) * math.cos(state[1])
        w = math.sin(state[1])
    else:
        if code == SMOOTH_TURN:  # state: direction, axis, angle per step, remaining steps
            if state[7] <= 0.0:
                _draw_turn(state, z, 1.0 / numbers[0], numbers[1])
            c, s = math.cos(state[6]), math.sin(state[6])
            x = c * state[0] + s * (state[4] * state[2] - state[5] * state[1])
            y = c * state[1] + s * (state[5] * state[0] - state[3] * state[2])
            w = c * state[2] + s * (state[3] * state[1] - state[4] * state[0])
            size = math.sqrt(x * x + y * y + w * w)
            state[0], state[1], state[2] = x / size, y / size, w / size
            state[7] -= 1.0
        elif code in (WAYPOINT, LOCAL_WAYPOINT):  # state: direction, goal
            dx, dy, dz = state[3] - px, state[4] - py, state[5] - pz
            if not dx * dx + dy * dy + dz * dz >= numbers[1] * numbers[1]:  # reached, or no goal yet (NaN)
                if code == WAYPOINT:
                    for axis in range(3):
                        state[3 + axis] = numbers[2 + axis] * _uniform(z[axis])
                else:
                    state[3], state[4] = px + numbers[2] * z[0], py + numbers[2] * z[1]
                    state[5] = pz + numbers[2] * z[2]
                dx, dy, dz = state[3] - px, state[4] - py, state[5] - pz
            _turn_towards(state, dx, dy, dz, numbers[0])
        x, y, w = state[0], state[1], state[2]
    return np.float32(x), np.float32(y), np.float32(w)


class Craft(NamedTuple):
    """How the free UAVs of B swarms want to fly S steps, and what all UAVs can fly; the swarms have one configuration.

    The free UAVs of a swarm fly by up to four mobilities: those of heads, bystanders, traffic and false tracks.
    """

    free: NDArray[np.int64]  # (B, n), the indices of the free UAVs, in the order of their mobilities
    laws: NDArray[np.int64]  # (4, 3): the number of each mobility, its UAVs, and random numbers of one in a step
    constants: NDArray[np.float64]  # (4, 6), of the mobilities
    steps: int  # S
    normals: NDArray[np.float32]  # (B, w), random numbers: for each mobility (S, its UAVs, its draws)
    state: NDArray[np.float64]  # (B, n, MOBILITY_STATE), changed in place
    jitter: np.float32 = _ZERO  # heads add the noise of the flight times this
    kinematics: int = 0  # its number; with UNIT the free UAVs fly all steps before the others
    numbers: NDArray[np.float32] = np.zeros(4, np.float32)  # constants of the kinematics
    pushes: NDArray[np.float32] = np.empty((0, 0, 0, 0), np.float32)  # (B, S, N + R, k), its random numbers
    kept: NDArray[np.float32] = np.empty((0, 0, 0), np.float32)  # (B, N + R, k), its state, changed in place
    rows: NDArray[np.float32] = np.empty((10, 0), np.float32)  # (10, N + R), memory for a step of the kinematics


def make_craft(swarms: int) -> Craft:
    """The craft of B swarms that fly with ``unit``, and whose free UAVs have flown."""
    free, state = np.zeros((swarms, 1), np.int64), np.empty((swarms, 0, MOBILITY_STATE))
    return Craft(free, np.zeros((4, 3), np.int64), np.zeros((4, 6)), 0, np.empty((swarms, 0), np.float32), state)


@compiled(inner=True, _nrt=False, error_model="numpy")
def _fly_free_uavs(b, start, first, last, craft, motion, noise, position, velocity):
    """Velocities of the free UAVs of swarm b from instant ``first`` to ``last`` - 1; step 0 is at instant ``start``."""
    low = begin = 0
    for law in range(4):
        code, count, each = craft.laws[law]
        numbers, width, stop = craft.constants[law], count * each, low + count
        jitter = craft.jitter if law == 0 else _ZERO
        for j in range(low, stop if code != NOT_COMPILED else low):
            i, state = craft.free[b, j], craft.state[b, j]
            flies, place = motion[b, i] != DESTROYED, position[b, first, i]
            px, py, pz = np.float64(place[0]), np.float64(place[1]), np.float64(place[2])
            for t in range(first, last):
                s = t - start
                drawn = craft.normals[b, begin + s * width + (j - low) * each :]
                x, y, z = norm(*_step_mobility(code, state, drawn, px, py, pz, numbers))
                if jitter > _ZERO:
                    x, y, z = norm(
                        x + jitter * noise[s, i, 0], y + jitter * noise[s, i, 1], z + jitter * noise[s, i, 2]
                    )
                # Assigned, not multiplied: the sign of a zero would show which of the destroyed UAVs were free.
                velocity[b, t, i, 0] = x if flies else _ZERO
                velocity[b, t, i, 1] = y if flies else _ZERO
                velocity[b, t, i, 2] = z if flies else _ZERO
                px, py, pz = px + x, py + y, pz + z
        low, begin = stop, begin + width * craft.steps


@compiled()
def fly_free(start, first, craft, motion, noise, position, velocity):
    """Velocities of the free UAVs in all steps from instant ``first`` on, in place; step 0 is at ``start``."""
    for b in range(len(motion)):
        drawn = noise[b]
        _fly_free_uavs(b, start, first, velocity.shape[1], craft, motion, drawn, position, velocity)


@compiled(inner=True)
def move(b, t, position, velocity):
    """Write the next positions of all UAVs, p_{t+1} = p_t + v_t."""
    for i in range(velocity.shape[2]):
        for axis in range(3):
            position[b, t + 1, i, axis] = position[b, t, i, axis] + velocity[b, t, i, axis]


@compiled()
def integrate(start, position, velocity):
    """Integrate the velocities from ``start`` on, in place."""
    for b in range(velocity.shape[0]):
        for t in range(start, velocity.shape[1]):
            move(b, t, position, velocity)


@compiled(inner=True, _nrt=False, error_model="numpy")
def _limit(numbers, b, t, motion, state, rows, velocity):
    """Turn UAV i of swarm b in step t by at most ``state[b, i, 0]`` towards what it wants; one that turns slows down.

    All but the angles become vector instructions, so what it needs of a UAV is a column of ``rows`` ``(10, N)``.
    """
    uavs, slowest, most = motion.shape[1], numbers[0], numbers[1]
    x, y, z, u, v, w = rows[0], rows[1], rows[2], rows[3], rows[4], rows[5]
    before, cosine, c, s = rows[6], rows[7], rows[8], rows[9]
    for i in range(uavs):
        x[i], y[i], z[i] = velocity[b, t - 1, i, 0], velocity[b, t - 1, i, 1], velocity[b, t - 1, i, 2]
        u[i], v[i], w[i] = velocity[b, t, i, 0], velocity[b, t, i, 1], velocity[b, t, i, 2]
    for i in range(uavs):
        before[i] = np.sqrt(x[i] * x[i] + y[i] * y[i] + z[i] * z[i])
        scale = _ONE / max(before[i], np.float32(1e-6))
        x[i], y[i], z[i] = x[i] * scale, y[i] * scale, z[i] * scale
        cosine[i] = min(max(x[i] * u[i] + y[i] * v[i] + z[i] * w[i], -_ONE), _ONE)
    for i in range(uavs):
        angle = min(np.float32(math.acos(cosine[i])), state[b, i, 0])
        c[i], s[i] = np.float32(math.cos(angle)), np.float32(math.sin(angle))
    for i in range(uavs):
        px, py, pz = u[i] - cosine[i] * x[i], v[i] - cosine[i] * y[i], w[i] - cosine[i] * z[i]
        size = np.sqrt(px * px + py * py + pz * pz)
        level = size < np.float32(1e-4)  # ahead or behind: turn in the level plane
        px, py, pz = -y[i] if level else px, x[i] if level else py, _ZERO if level else pz
        size = np.sqrt(px * px + py * py) + _TINY if level else size
        part = s[i] / size
        dx, dy, dz = c[i] * x[i] + part * px, c[i] * y[i] + part * py, c[i] * z[i] + part * pz
        unit = _ONE / np.sqrt(dx * dx + dy * dy + dz * dz + _TINY)
        goal = slowest + (_ONE - slowest) * np.float32(0.5) * (_ONE + cosine[i])
        speed = min(max(goal, before[i] - most), before[i] + most)
        speed = min(max(speed, _ZERO), _ONE)
        u[i], v[i], w[i] = dx * unit * speed, dy * unit * speed, dz * unit * speed
    for i in range(uavs):
        flies = motion[b, i] != DESTROYED
        velocity[b, t, i, 0] = u[i] if flies else _ZERO
        velocity[b, t, i, 1] = v[i] if flies else _ZERO
        velocity[b, t, i, 2] = w[i] if flies else _ZERO


@compiled(inner=True, _nrt=False, error_model="numpy")
def steer(code, numbers, b, s, t, motion, normals, state, rows, position, velocity):
    """Replace the wanted directions of swarm b in step t by velocities; ``normals`` ``(B, S, N, k)`` has step s."""
    if code == LIMITED:
        _limit(numbers, b, t, motion, state, rows, velocity)
        return
    for i in range(motion.shape[1]):
        if motion[b, i] == DESTROYED:
            velocity[b, t, i, 0] = velocity[b, t, i, 1] = velocity[b, t, i, 2] = _ZERO
            continue
        x, y, z = velocity[b, t, i, 0], velocity[b, t, i, 1], velocity[b, t, i, 2]
        bx, by, bz = velocity[b, t - 1, i, 0], velocity[b, t - 1, i, 1], velocity[b, t - 1, i, 2]
        if code == VARIED_SPEED:
            state[b, i, 1] = numbers[0] * state[b, i, 1] + numbers[1] * normals[b, s, i, 0]
            speed = min(max(state[b, i, 0] * (_ONE + state[b, i, 1]), numbers[2]), numbers[3])
            x, y, z = x * speed, y * speed, z * speed
        elif code == LAGGED:
            share = state[b, i, 0]
            x, y, z = bx + (x - bx) * share, by + (y - by) * share, bz + (z - bz) * share
        else:
            rise = (state[b, i, 0] - position[b, t, i, 2]) / np.float32(10.0)
            z = min(max(rise, -numbers[0]), numbers[0])
            scale = np.sqrt(_ONE - z * z) / np.sqrt(x * x + y * y + _TINY)
            x, y = x * scale, y * scale
        velocity[b, t, i, 0], velocity[b, t, i, 1], velocity[b, t, i, 2] = x, y, z


@compiled()
def fly_kinematics(code, numbers, t, motion, normals, state, position, velocity):
    """Step t of all models but ``unit``; the arguments are those of ``Kinematics.fly``."""
    rows = np.empty((10, motion.shape[1]), np.float32)
    for b in range(motion.shape[0]):
        steer(code, numbers, b, 0, t, motion, normals, state, rows, position, velocity)
        move(b, t, position, velocity)


@compiled(inner=True, _nrt=False)
def begin_step(b, s, t, motion, craft, noise, position, velocity):
    """Fly the free UAVs in step t; with other kinematics than ``unit`` they want what depends on what was flown.

    With ``unit`` it is not called: the free UAVs have flown all steps.
    """
    _fly_free_uavs(b, t - s, t, t + 1, craft, motion, noise, position, velocity)


@compiled(inner=True, _nrt=False)
def end_step(b, s, t, motion, craft, position, velocity):
    """Turn what all UAVs want in step t into what they fly, with other kinematics than ``unit``."""
    code, numbers = craft.kinematics, craft.numbers
    steer(code, numbers, b, s, t, motion, craft.pushes, craft.kept, craft.rows, position, velocity)


@compiled(inner=True)
def split_links(motion, source):
    """The indices of the UAVs that follow, and of those that they copy; loops compile faster than NumPy's functions."""
    followers, sources = np.empty(len(motion), np.int64), np.empty(len(motion), np.int64)
    copied = np.zeros(len(motion), np.bool_)
    n = k = 0
    for i in range(len(motion)):
        if motion[i] == FOLLOWS:
            followers[n] = i
            copied[source[i]] = source[i] >= 0
            n += 1
    for i in range(len(motion)):
        if copied[i]:
            sources[k] = i
            k += 1
    return followers[:n], sources[:k]


@compiled()
def fly_alone(motion, start, noise, position, velocity, craft):
    """A flight without followers."""
    for b in range(len(motion)):
        drawn = noise[b]
        for s in range(noise.shape[1]):
            if craft.kinematics != UNIT:
                begin_step(b, s, start + s, motion, craft, drawn, position, velocity)
                end_step(b, s, start + s, motion, craft, position, velocity)
            move(b, start + s, position, velocity)


@compiled(inner=True)
def _nearest(position, i, heads):
    """The one of the UAVs ``heads`` that is nearest to UAV i; -1 if there is none."""
    nearest, best = -1, np.inf
    for h in heads:
        dx = position[i, 0] - position[h, 0]
        dy = position[i, 1] - position[h, 1]
        dz = position[i, 2] - position[h, 2]
        distance = float(dx * dx + dy * dy + dz * dz)
        if distance < best:
            nearest, best = h, distance
    return nearest


@compiled()
def remerge(head, alive, apart, position, root, source):
    """Assign every living follower of a destroyed head to the nearest remaining head; -1 if no head remains.

    A follower that copied a destroyed follower copies the nearest living one above it, and joins a head only if there
    is none. A predator whose prey has lost its head chases the UAVs of the nearest head. ``apart`` ``(B, N)`` are the
    decoys and bystanders; ``root`` and ``source`` ``(B, N)`` are updated in place.
    """
    episodes, uavs = root.shape
    heads = np.empty(uavs, np.int64)
    for b in range(episodes):
        living = 0
        for i in range(uavs):
            if head[b, i] and alive[b, i]:
                heads[living] = i
                living += 1
        for i in range(uavs):
            if head[b, i] or not alive[b, i] or source[b, i] == i:
                continue
            above = source[b, i]
            while 0 <= above < uavs and not (alive[b, above] or head[b, above] or source[b, above] == above):
                above = source[b, above]
            if above < 0 or (above < uavs and not alive[b, above]):
                above = _nearest(position[b], i, heads[:living])
            source[b, i] = above
        for i in range(uavs):
            if head[b, i] or apart[b, i] or not alive[b, i]:
                continue
            above = source[b, i]
            while 0 <= above < uavs and not (head[b, above] or source[b, above] == above):
                above = source[b, above]
            root[b, i] = above if 0 <= above < uavs and head[b, above] else -1
