"""The compiled loops of the paper's follow strategies f1 to f7 and of random ones, with the arrays of ``kernels``."""

from __future__ import annotations

import numpy as np

from usnet_env.compiling import compiled
from usnet_env.swarm.kernels import begin_step, displacement, end_step, finish_step, norm, split_links

# The network of f7: inputs -> hidden tanh units -> 3 outputs, in this order.
MLP_LAGS = 4
MLP_INPUTS = 3 + 3 * MLP_LAGS + 3 * MLP_LAGS  # relative position, inputs velocities, head velocities
MLP_HIDDEN = 16

# The coefficients of a random strategy: three terms, each with the number of its kind, its lag, its weight and a
# network of 6 x 8 and 8 x 3 weights; then the output map: a rotation, a saturation, an offset and a pull.
TERM_KINDS = ("linear", "cube", "root", "product", "network")
TERM_SIZE, OUTPUT_SIZE = 3 + 48 + 24, 9 + 1 + 3 + 1
COEFFICIENTS = 3 * TERM_SIZE + OUTPUT_SIZE

_ONE, _ZERO = np.float32(1.0), np.float32(0.0)


@compiled()
def fly_lags(kappa, square, noise_scale, source, motion, start, noise, position, velocity, plan):
    """f1 to f5: v_{i,t+1} = norm(sum_tau kappa_tau v_{iL,t-tau}^p + kappa_n n), with p = 2 where ``square``.

    The loop computes the sum once per step and UAV that is copied.
    """
    steps, uavs = noise.shape[1], noise.shape[2]
    lags = len(kappa)
    target = np.zeros((uavs, 3), np.float32)
    for b in range(len(motion)):
        followers, sources = split_links(motion[b], source[b])
        for s in range(steps):
            t = start + s
            begin_step(b, s, t, motion, plan, noise, position, velocity)
            for h in sources:
                for axis in range(3):
                    total = _ZERO
                    for lag in range(lags):
                        v = velocity[b, t - 1 - lag, h, axis]
                        total += kappa[lag] * (v * v if square else v)
                    target[h, axis] = total
            for i in followers:
                h = source[b, i]
                finish_step(b, s, t, i, target[h, 0], target[h, 1], target[h, 2], noise_scale, noise, velocity)
            end_step(b, s, t, motion, plan, position, velocity)


@compiled()
def fly_range(kappa, pull, reach, noise_scale, source, motion, start, noise, position, velocity, plan):
    """f6: norm(kappa_0 v_{iL,t} + kappa_n n + 1{|d| > kappa_r} kappa_p d / |d|), d = p_{iL,t} - p_{i,t}."""
    for b in range(len(motion)):
        followers, _ = split_links(motion[b], source[b])
        for s in range(noise.shape[1]):
            t = start + s
            begin_step(b, s, t, motion, plan, noise, position, velocity)
            for i in followers:
                h = source[b, i]
                dx, dy, dz = displacement(position, b, t - 1, h, i)
                distance = np.sqrt(dx * dx + dy * dy + dz * dz)
                gain = pull / distance if distance > reach else _ZERO
                x = kappa * velocity[b, t - 1, h, 0] + noise_scale * noise[b, s, i, 0] + gain * dx
                y = kappa * velocity[b, t - 1, h, 1] + noise_scale * noise[b, s, i, 1] + gain * dy
                z = kappa * velocity[b, t - 1, h, 2] + noise_scale * noise[b, s, i, 2] + gain * dz
                velocity[b, t, i, 0], velocity[b, t, i, 1], velocity[b, t, i, 2] = norm(x, y, z)
            end_step(b, s, t, motion, plan, position, velocity)


@compiled(inner=True)
def _tanh(x):
    """Hyperbolic tangent in float32 without a library call: (1 - e) / (1 + e), e = exp(-2|x|) by a polynomial."""
    magnitude = min(abs(x), np.float32(9.0))
    y = magnitude * np.float32(-2.8853900817779268)  # -2 / ln 2
    exponent = np.float32(np.floor(y + np.float32(0.5)))
    f = (y - exponent) * np.float32(0.6931471805599453)
    e = np.float32(1.0 / 720.0)
    e = e * f + np.float32(1.0 / 120.0)
    e = e * f + np.float32(1.0 / 24.0)
    e = e * f + np.float32(1.0 / 6.0)
    e = e * f + np.float32(0.5)
    e = e * f + _ONE
    e = e * f + _ONE
    e = np.float32(np.ldexp(e, np.int32(exponent)))
    result = (_ONE - e) / (_ONE + e)
    return result if x >= _ZERO else -result


@compiled()
def fly_mlp(parameters, position_scale, noise_scale, source, motion, start, noise, position, velocity, plan):
    """f7: norm(MLP(P_{i,t+1}, V_{iL,t}, p_{iL,t-3}) + kappa_n n), one network per episode.

    The contribution of a UAV that is copied to the hidden layer is computed once per step.
    """
    steps, uavs = noise.shape[1], noise.shape[2]
    from_head = np.empty((uavs, MLP_HIDDEN), np.float32)
    hidden = np.empty(MLP_HIDDEN, np.float32)
    inputs = np.empty(3 + 3 * MLP_LAGS, np.float32)
    scale = _ONE / position_scale
    inner = MLP_INPUTS * MLP_HIDDEN
    for b in range(len(motion)):
        weights = parameters[b, :inner].reshape((MLP_INPUTS, MLP_HIDDEN))
        bias = parameters[b, inner : inner + MLP_HIDDEN]
        readout = parameters[b, inner + MLP_HIDDEN :].reshape((MLP_HIDDEN, 3))
        followers, sources = split_links(motion[b], source[b])
        for s in range(steps):
            t = start + s
            begin_step(b, s, t, motion, plan, noise, position, velocity)
            for h in sources:
                for unit in range(MLP_HIDDEN):
                    from_head[h, unit] = bias[unit]
                for lag in range(MLP_LAGS):
                    for axis in range(3):
                        v = velocity[b, t - 1 - lag, h, axis]
                        row = 3 + 3 * MLP_LAGS + 3 * lag + axis
                        for unit in range(MLP_HIDDEN):
                            from_head[h, unit] += v * weights[row, unit]
            for i in followers:
                h = source[b, i]
                for axis in range(3):
                    inputs[axis] = (position[b, t, i, axis] - position[b, t - MLP_LAGS, h, axis]) * scale
                for lag in range(MLP_LAGS):
                    for axis in range(3):
                        inputs[3 + 3 * lag + axis] = velocity[b, t - 1 - lag, i, axis]
                for unit in range(MLP_HIDDEN):
                    hidden[unit] = from_head[h, unit]
                for row in range(3 + 3 * MLP_LAGS):
                    for unit in range(MLP_HIDDEN):
                        hidden[unit] += inputs[row] * weights[row, unit]
                n = noise[b, s, i]
                x, y, z = noise_scale * n[0], noise_scale * n[1], noise_scale * n[2]
                for unit in range(MLP_HIDDEN):
                    active = _tanh(hidden[unit])
                    x += active * readout[unit, 0]
                    y += active * readout[unit, 1]
                    z += active * readout[unit, 2]
                velocity[b, t, i, 0], velocity[b, t, i, 1], velocity[b, t, i, 2] = norm(x, y, z)
            end_step(b, s, t, motion, plan, position, velocity)


@compiled(inner=True)
def _add_term(term, velocity, past_velocity, total):
    """Add a term of a random strategy: of the head's ``velocity`` at its lag, and of that of a step earlier."""
    kind, weight = int(term[0]), term[2]
    if kind < 4:
        for axis in range(3):
            v = velocity[axis]
            if kind == 1:
                v = np.float32(1.7) * v * v * v
            elif kind == 2:
                v = np.sqrt(abs(v)) if v >= _ZERO else -np.sqrt(abs(v))
            elif kind == 3:
                v = np.float32(3.0) * velocity[(axis + 1) % 3] * velocity[(axis + 2) % 3]
            total[axis] += weight * v
        return
    for unit in range(8):
        inner = _ZERO
        for axis in range(3):
            inner += velocity[axis] * term[3 + 8 * axis + unit] + past_velocity[axis] * term[3 + 8 * (3 + axis) + unit]
        active = _tanh(inner)
        for axis in range(3):
            total[axis] += weight * active * term[51 + 3 * unit + axis]


@compiled()
def fly_random(coefficients, noise_scale, source, motion, start, noise, position, velocity, plan):
    """Random strategies, ``coefficients`` ``(B, COEFFICIENTS)``: see ``RandomFollowStrategy``.

    All followers of a UAV get the same numbers from it, but for the pull.
    """
    uavs = noise.shape[2]
    head_output = np.empty((uavs, 3), np.float32)
    total = np.empty(3, np.float32)
    for b in range(len(motion)):
        row = coefficients[b]
        output = row[len(row) - OUTPUT_SIZE :]
        followers, sources = split_links(motion[b], source[b])
        for s in range(noise.shape[1]):
            t = start + s
            begin_step(b, s, t, motion, plan, noise, position, velocity)
            for h in sources:
                total[:] = _ZERO
                for k in range(3):
                    term = row[k * TERM_SIZE : (k + 1) * TERM_SIZE]
                    lag = int(term[1])
                    _add_term(term, velocity[b, t - 1 - lag, h], velocity[b, t - 2 - lag, h], total)
                if output[9] > _ZERO:
                    for axis in range(3):
                        total[axis] = _tanh(output[9] * total[axis]) / output[9]
                for axis in range(3):
                    turn = output[3 * axis : 3 * axis + 3]
                    head_output[h, axis] = total[0] * turn[0] + total[1] * turn[1] + total[2] * turn[2]
            for i in followers:
                h = source[b, i]
                x, y, z = head_output[h, 0], head_output[h, 1], head_output[h, 2]
                if output[13] > _ZERO:
                    gx, gy, gz = displacement(position, b, t - 1, h, i)
                    gx, gy, gz = gx + output[10], gy + output[11], gz + output[12]
                    weight = output[13] / max(np.sqrt(gx * gx + gy * gy + gz * gz), _ONE)
                    x, y, z = x + weight * gx, y + weight * gy, z + weight * gz
                finish_step(b, s, t, i, x, y, z, noise_scale, noise, velocity)
            end_step(b, s, t, motion, plan, position, velocity)
