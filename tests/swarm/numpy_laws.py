"""The directions of f1 to f7 and of random laws in NumPy, against which their compiled loops are tested."""

import numpy as np

from usnet_env.swarm import follow_kernels
from usnet_env.swarm.follow import FollowFunction, LaggedSum, TanhNetworkStrategy


def slow(strategy, parameters):
    """The strategy without its compiled loop, for one swarm with these parameters."""
    direct = {LaggedSum: sum_lags, TanhNetworkStrategy: read_network}.get(type(strategy), stay_in_range)
    if parameters.size == follow_kernels.COEFFICIENTS:
        direct = obey_law
    return FollowFunction(lambda inputs: direct(strategy, inputs), strategy.lags, strategy.noise)


def sum_lags(strategy, inputs):
    past = inputs.head_velocity[:, : strategy.lags]
    return (past * past if strategy.square else past).sum(axis=1)


def stay_in_range(strategy, inputs):
    gap = inputs.head_position[:, 1] - inputs.own_position[:, 1]
    distance = np.linalg.norm(gap, axis=1, keepdims=True)
    return inputs.head_velocity[:, 0] + np.where(distance > strategy.reach, gap / np.maximum(distance, 1e-6), 0)


def read_network(strategy, inputs):
    n, lags, units = len(inputs.own_position), follow_kernels.MLP_LAGS, follow_kernels.MLP_HIDDEN
    inner, parameters = follow_kernels.MLP_INPUTS * units, inputs.parameters
    offset = (inputs.own_position[:, 0] - inputs.head_position[:, lags]) / strategy.position_scale
    own = inputs.own_position[:, :lags] - inputs.own_position[:, 1 : lags + 1]
    features = np.hstack([offset, own.reshape(n, -1), inputs.head_velocity[:, :lags].reshape(n, -1)])
    hidden = np.tanh(features @ parameters[:inner].reshape(-1, units) + parameters[inner : inner + units])
    return hidden @ parameters[inner + units :].reshape(units, 3)


def obey_law(strategy, inputs):
    law, end = inputs.parameters[: -follow_kernels.OUTPUT_SIZE], inputs.parameters[-follow_kernels.OUTPUT_SIZE :]
    total = sum(_evaluate(term, inputs.head_velocity) for term in law.reshape(-1, follow_kernels.TERM_SIZE))
    total = (np.tanh(end[9] * total) / end[9] if end[9] else total) @ end[:9].reshape(3, 3).T
    gap = inputs.head_position[:, 1] + end[10:13] - inputs.own_position[:, 1]
    return total + end[13] * gap / np.maximum(np.linalg.norm(gap, axis=1, keepdims=True), 1)


def _evaluate(term, head_velocity):
    lag, v = int(term[1]), head_velocity[:, int(term[1])]
    both = head_velocity[:, lag : lag + 2].reshape(-1, 6)
    kinds = {
        "linear": v,
        "cube": 1.7 * v**3,
        "root": np.sign(v) * np.sqrt(np.abs(v)),
        "product": 3 * v[:, [1, 2, 0]] * v[:, [2, 0, 1]],
        "network": np.tanh(both @ term[3:51].reshape(6, 8)) @ term[51:].reshape(8, 3),
    }
    return term[2] * kinds[follow_kernels.TERM_KINDS[int(term[0])]]
