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
NOT_COMPILED = -1  # the code of another mobility
UNIT, VARIED_SPEED, LAGGED, LIMITED, LAYERED = range(5)  # the kinematics that are compiled
MOBILITY_STATE = 8  # number of float64 values in the mobility state of a UAV
NORMALS = 5  # the most standard normal numbers that a UAV of a compiled mobility needs per step

_ONE = np.float32(1.0)
_ZERO = np.float32(0.0)
_TINY = np.float32(1e-12)


@compiled(inner=True, error_model="numpy")
def norm(x, y, z):
    """The vector (x, y, z) scaled to length 1."""
    size = _ONE / np.sqrt(x * x + y * y + z * z + _TINY)
    return x * size, y * size, z * size


@compiled(inner=True, error_model="numpy")
def displacement(position, b, t, i, j):
    """The vector from UAV j to UAV i at instant t, metres."""
    end, origin = position[b, t, i], position[b, t, j]
    return end[0] - origin[0], end[1] - origin[1], end[2] - origin[2]


@compiled(inner=True, error_model="numpy")
def finish_step(b, s, t, i, x, y, z, noise_scale, noise, velocity):
    """Write norm((x, y, z) + noise) as the velocity of UAV i in step t."""
    n = noise[b, s, i]
    velocity[b, t, i, 0], velocity[b, t, i, 1], velocity[b, t, i, 2] = norm(
        x + noise_scale * n[0], y + noise_scale * n[1], z + noise_scale * n[2]
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
def _step_mobility(code, state, z, px, py, pz, constants):
    """One step of one free UAV at (px, py, pz): update ``state`` and return the direction of flight, float32."""
    x, y, w = 0.0, 0.0, 0.0
    if code == IID:
        x, y, w = np.float64(z[0]), np.float64(z[1]), np.float64(z[2])
    elif code == GAUSS_MARKOV:  # state: azimuth, pitch, and their means
        phi = constants[0]  # lag-one autocorrelation
        sigma = math.sqrt(1.0 - phi * phi)
        state[0] = phi * state[0] + (1.0 - phi) * state[2] + sigma * math.sqrt(constants[1]) * z[0]
        state[1] = phi * state[1] + (1.0 - phi) * state[3] + sigma * math.sqrt(constants[2]) * z[1]
        x = math.cos(state[0]) * math.cos(state[1])
        y = math.sin(state[0]) * math.cos(state[1])
        w = math.sin(state[1])
    else:
        if code == SMOOTH_TURN:  # state: direction, axis, angle per step, remaining steps
            if state[7] <= 0.0:
                _draw_turn(state, z, 1.0 / constants[0], constants[1])
            c, s = math.cos(state[6]), math.sin(state[6])
            x = c * state[0] + s * (state[4] * state[2] - state[5] * state[1])
            y = c * state[1] + s * (state[5] * state[0] - state[3] * state[2])
            w = c * state[2] + s * (state[3] * state[1] - state[4] * state[0])
            size = math.sqrt(x * x + y * y + w * w)
            state[0], state[1], state[2] = x / size, y / size, w / size
            state[7] -= 1.0
        elif code in (WAYPOINT, LOCAL_WAYPOINT):  # state: direction, goal
            dx, dy, dz = state[3] - px, state[4] - py, state[5] - pz
            if not dx * dx + dy * dy + dz * dz >= constants[1] * constants[1]:  # reached, or no goal yet (NaN)
                if code == WAYPOINT:
                    for axis in range(3):
                        state[3 + axis] = constants[2 + axis] * _uniform(z[axis])
                else:
                    state[3], state[4] = px + constants[2] * z[0], py + constants[2] * z[1]
                    state[5] = pz + constants[2] * z[2]
                dx, dy, dz = state[3] - px, state[4] - py, state[5] - pz
            _turn_towards(state, dx, dy, dz, constants[0])
        x, y, w = state[0], state[1], state[2]
    return np.float32(x), np.float32(y), np.float32(w)


class FlightPlan(NamedTuple):
    """How the n free UAVs of B swarms want to fly S steps, and what all UAVs can fly.

    The swarms have one configuration, so the free UAVs of a column have one mobility.
    """

    free: NDArray[np.int64] = np.empty((0, 0), np.int64)  # (B, n), the indices of the free UAVs
    codes: NDArray[np.int64] = np.empty(0, np.int64)  # (n,), of their mobilities
    mobility_constants: NDArray[np.float64] = np.empty((0, 6))  # (n, 6)
    mobility_noise: NDArray[np.float32] = np.empty((0, 0, 0, 0), np.float32)  # (B, S, n, NORMALS), standard normal
    mobility_state: NDArray[np.float64] = np.empty((0, 0, MOBILITY_STATE))  # (B, n, MOBILITY_STATE), changed in place
    jitter: NDArray[np.float32] = np.empty(0, np.float32)  # (n,), times this they add the noise of the flight
    kinematics: int = UNIT  # its code; with UNIT the free UAVs fly all steps before the others
    kinematic_constants: NDArray[np.float32] = np.empty(0, np.float32)  # (4,)
    kinematic_noise: NDArray[np.float32] = np.empty((0, 0, 0, 0), np.float32)  # (B, S, N + R, k), standard normal
    kinematic_state: NDArray[np.float32] = np.empty((0, 0, 0), np.float32)  # (B, N + R, k), changed in place


FLOWN = FlightPlan()  # of swarms that fly with `unit`, and whose free UAVs have flown


@compiled(inner=True, _nrt=False, error_model="numpy")
def _fly_free_uavs(b, start, first, last, plan, motion, noise, position, velocity):
    """Velocities of the free UAVs of swarm b from instant ``first`` to ``last`` - 1; step 0 is at instant ``start``."""
    for j in range(len(plan.codes)):
        code, constants, jitter = plan.codes[j], plan.mobility_constants[j], plan.jitter[j]
        if code == NOT_COMPILED:
            continue
        i, state = plan.free[b, j], plan.mobility_state[b, j]
        flies, begin = motion[b, i] != DESTROYED, position[b, first, i]
        px, py, pz = np.float64(begin[0]), np.float64(begin[1]), np.float64(begin[2])
        for t in range(first, last):
            s = t - start
            x, y, z = norm(*_step_mobility(code, state, plan.mobility_noise[b, s, j], px, py, pz, constants))
            if jitter > _ZERO:
                n = noise[b, s, i]
                x, y, z = norm(x + jitter * n[0], y + jitter * n[1], z + jitter * n[2])
            # Assigned, not multiplied: the sign of a zero would show which of the destroyed UAVs were free.
            velocity[b, t, i, 0] = x if flies else _ZERO
            velocity[b, t, i, 1] = y if flies else _ZERO
            velocity[b, t, i, 2] = z if flies else _ZERO
            px, py, pz = px + x, py + y, pz + z


@compiled()
def fly_free(start, first, plan, motion, noise, position, velocity):
    """Velocities of the free UAVs in all steps from instant ``first`` on, in place; step 0 is at ``start``."""
    for b in range(len(motion)):
        _fly_free_uavs(b, start, first, velocity.shape[1], plan, motion, noise, position, velocity)


@compiled(inner=True)
def move(b, t, position, velocity):
    """Write the next positions of all UAVs, p_{t+1} = p_t + v_t."""
    for i in range(velocity.shape[2]):
        for axis in range(3):
            position[b, t + 1, i, axis] = position[b, t, i, axis] + velocity[b, t, i, axis]


@compiled(inner=True, _nrt=False, error_model="numpy")
def _limit(turn, slowest, most_change, u, v, w, x, y, z):
    """Turn the velocity (x, y, z) by at most ``turn`` radians towards (u, v, w); a UAV that turns slows down."""
    speed_before = np.sqrt(x * x + y * y + z * z)
    scale = _ONE / max(speed_before, np.float32(1e-6))
    x, y, z = x * scale, y * scale, z * scale
    cosine = min(max(x * u + y * v + z * w, -_ONE), _ONE)
    angle = min(np.float32(math.acos(cosine)), turn)
    px, py, pz = u - cosine * x, v - cosine * y, w - cosine * z
    size = np.sqrt(px * px + py * py + pz * pz)
    if size < np.float32(1e-4):  # ahead or behind: turn in the level plane
        px, py, pz = -y, x, _ZERO
        size = np.sqrt(px * px + py * py) + _TINY
    c, s = np.float32(math.cos(angle)), np.float32(math.sin(angle)) / size
    x, y, z = norm(c * x + s * px, c * y + s * py, c * z + s * pz)
    goal = slowest + (_ONE - slowest) * np.float32(0.5) * (_ONE + cosine)
    speed = min(max(min(max(goal, speed_before - most_change), speed_before + most_change), _ZERO), _ONE)
    return x * speed, y * speed, z * speed


@compiled(inner=True, _nrt=False, error_model="numpy")
def _steer(b, s, t, motion, plan, position, velocity):
    """Replace the wanted directions of swarm b in step t by velocities."""
    code, constants, state = plan.kinematics, plan.kinematic_constants, plan.kinematic_state
    for i in range(motion.shape[1]):
        if motion[b, i] == DESTROYED:
            velocity[b, t, i, 0] = velocity[b, t, i, 1] = velocity[b, t, i, 2] = _ZERO
            continue
        x, y, z = velocity[b, t, i, 0], velocity[b, t, i, 1], velocity[b, t, i, 2]
        bx, by, bz = velocity[b, t - 1, i, 0], velocity[b, t - 1, i, 1], velocity[b, t - 1, i, 2]
        if code == VARIED_SPEED:
            state[b, i, 1] = constants[0] * state[b, i, 1] + constants[1] * plan.kinematic_noise[b, s, i, 0]
            speed = min(max(state[b, i, 0] * (_ONE + state[b, i, 1]), constants[2]), constants[3])
            x, y, z = x * speed, y * speed, z * speed
        elif code == LAGGED:
            rate = state[b, i, 0]
            x, y, z = bx + (x - bx) * rate, by + (y - by) * rate, bz + (z - bz) * rate
        elif code == LIMITED:
            x, y, z = _limit(state[b, i, 0], constants[0], constants[1], x, y, z, bx, by, bz)
        else:
            rise = (state[b, i, 0] - position[b, t, i, 2]) / np.float32(10.0)
            z = min(max(rise, -constants[0]), constants[0])
            scale = np.sqrt(_ONE - z * z) / np.sqrt(x * x + y * y + _TINY)
            x, y = x * scale, y * scale
        velocity[b, t, i, 0], velocity[b, t, i, 1], velocity[b, t, i, 2] = x, y, z


@compiled(inner=True, _nrt=False)
def begin_step(b, s, t, motion, plan, noise, position, velocity):
    """Fly the free UAVs in step t, unless the kinematics is ``unit``: then they have flown all steps before."""
    if plan.kinematics != UNIT:
        _fly_free_uavs(b, t - s, t, t + 1, plan, motion, noise, position, velocity)


@compiled(inner=True, _nrt=False)
def end_step(b, s, t, motion, plan, position, velocity):
    """Turn what all UAVs want in step t into what they fly, and move them."""
    if plan.kinematics != UNIT:
        _steer(b, s, t, motion, plan, position, velocity)
    move(b, t, position, velocity)


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
def fly_without_followers(motion, start, noise, position, velocity, plan):
    """A flight without followers."""
    for b in range(len(motion)):
        for s in range(noise.shape[1]):
            begin_step(b, s, start + s, motion, plan, noise, position, velocity)
            end_step(b, s, start + s, motion, plan, position, velocity)


@compiled(inner=True)
def _find_nearest_head(position, i, head, alive):
    """The living head that is nearest to UAV i; -1 if there is none."""
    nearest, least = -1, np.inf
    for h in range(len(head)):
        if head[h] and alive[h]:
            dx = position[i, 0] - position[h, 0]
            dy = position[i, 1] - position[h, 1]
            dz = position[i, 2] - position[h, 2]
            distance = float(dx * dx + dy * dy + dz * dz)
            if distance < least:
                nearest, least = h, distance
    return nearest


@compiled()
def remerge(head, alive, is_unled, position, root, source):
    """Assign every living follower of a destroyed head to the nearest remaining head; -1 if no head remains.

    A follower that copied a destroyed follower copies the nearest living one above it, and joins a head only if there
    is none. A predator whose prey has lost its head chases the UAVs of the nearest head. ``is_unled`` ``(B, N)`` marks
    decoys and bystanders; ``root`` and ``source`` ``(B, N)`` are updated in place.
    """
    episodes, uavs = root.shape
    for b in range(episodes):
        for i in range(uavs):
            if head[b, i] or not alive[b, i] or source[b, i] == i:
                continue
            leader = source[b, i]
            while 0 <= leader < uavs and not (alive[b, leader] or head[b, leader] or source[b, leader] == leader):
                leader = source[b, leader]
            if leader < 0 or (leader < uavs and not alive[b, leader]):
                leader = _find_nearest_head(position[b], i, head[b], alive[b])
            source[b, i] = leader
        for i in range(uavs):
            if head[b, i] or is_unled[b, i] or not alive[b, i]:
                continue
            leader = source[b, i]
            while 0 <= leader < uavs and not (head[b, leader] or source[b, leader] == leader):
                leader = source[b, leader]
            root[b, i] = leader if 0 <= leader < uavs and head[b, leader] else -1
