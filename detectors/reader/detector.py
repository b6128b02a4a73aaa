"""The reader as a detector: a network that learned from simulated swarms who leads."""

from __future__ import annotations

from functools import cached_property
from typing import Annotated, Literal, NamedTuple

import numpy as np
from pydantic import Field
from scipy.special import expit, softmax

from detectors.base import Detector
from detectors.policy import Policy, choose
from detectors.reader.features import make_features
from detectors.reader.forward import Weights, load_reader, read
from detectors.reader.neighbourhoods import cut_swarm
from detectors.series.designs import check_pairs
from usnet_env.arrays import Floats, Indices, Singles
from usnet_env.detection import Detection, Tags
from usnet_env.window import Window

_DENSE = 400  # UAVs that are read as one window; a larger swarm is read in neighbourhoods
_DECIMALS = 6  # of a probability: smaller differences are rounding errors, and count as ties


class _Reading(NamedTuple):
    """What is read of n UAVs: ``(n,)`` each, ``follows`` ``(n, n)``; an own index means that a UAV follows none."""

    head: Floats
    leader: Indices
    root: Indices
    delay: Floats
    silent: float
    follows: Singles | None = None


class Reader(Detector):
    """Names heads by a network that was trained with labels on every kind of swarm that the simulator can draw.

    It reads statistics of every ordered pair of UAVs, and needs no PyTorch. More than 400 UAVs are read in
    neighbourhoods of UAVs that move alike.

    Args:
        policy: ``"cost"`` (default) names the set with the least expected cost (:func:`detectors.policy.choose`),
            nobody where probably nobody leads; ``"map"`` names the UAVs with a probability above 1/2.
        objective: ``"P2"`` (destroy all heads in few rounds) or ``"P1"`` (name the single head in one round).
        round_price: the expected cost of one more round of P2, in rounds; used by ``"cost"`` only.
        weights: ``"shipped"``, or the path of a weights file of ``usnet train reader``.

    Raises:
        ArgumentError: from :meth:`reset` and :meth:`detect`: an argument is refused, the weights file is missing or
            broken, or the window holds more than 10,000 UAVs.
    """

    tags = Tags(most_uavs=10_000)
    _made_by_reset = "_weights"  # a broken file is refused there

    policy: Literal["cost", "map"] = "cost"
    objective: Literal["P1", "P2"] = "P2"
    round_price: Annotated[float, Field(gt=0)] = 1.0
    weights: str = "shipped"

    @cached_property
    def _weights(self) -> Weights:
        return load_reader(self.check_arguments().weights)

    def detect(self, window: Window) -> Detection:
        """Name the heads of one window.

        Returns:
            Candidates; scores and ``extras["probability"]``, of being a head; ``leader`` (direct) and ``extras["root"]``
            (the head; own index: none; -1: destroyed or never seen to move); ``clusters``, one per root; attention, the
            probability that UAV i follows UAV j (``None`` of more than 400). In ``extras``: ``delay`` ``(N,)``, steps
            behind the leader; ``silent``, the probability that nobody leads; ``confidence``, that the UAVs with a
            probability above 1/2 are exactly the heads.
        """
        arguments = self.check_arguments()
        check_pairs(window.uavs)
        flying = np.flatnonzero(window.velocity_seen.any(axis=0))
        probability, delay = np.zeros((2, window.uavs))
        leader, root, clusters = np.full((3, window.uavs), -1, np.int64)
        attention, silent = None, 1.0
        if len(flying) > 1:
            read_some = _read_dense if len(flying) <= _DENSE else _read_neighbourhoods
            found = read_some(self._weights, window, flying)
            silent = round(found.silent, _DECIMALS)
            probability[flying] = found.head.round(_DECIMALS)
            leader[flying], root[flying] = flying[found.leader], flying[found.root]
            delay[flying] = found.delay
            clusters[flying] = np.unique(root[flying], return_inverse=True)[1]
            if found.follows is not None:
                attention = np.zeros((window.uavs, window.uavs))
                attention[np.ix_(flying, flying)] = found.follows
        policy = Policy(policy=arguments.policy, objective=arguments.objective, round_price=arguments.round_price)
        candidates = choose(probability, window.alive, policy, self.rng.random(window.uavs), silent=silent)
        confidence = float(np.maximum(probability, 1.0 - probability).prod())
        extras = {"probability": probability, "root": root, "delay": delay, "silent": silent, "confidence": confidence}
        return Detection(candidates, probability, clusters, leader, attention, extras)


def _read_dense(weights: Weights, window: Window, uavs: Indices) -> _Reading:
    """Read ``uavs`` of a window at once."""
    answer = read(weights, make_features(window.position[:, uavs], window.velocity[:, uavs], window.seen[:, uavs]))
    head, silent = expit(answer.head.astype(np.float64)), float(expit(np.float64(answer.silent)))
    leader, root = answer.leader.argmax(axis=1), answer.root.argmax(axis=1)
    delay = np.where(leader == np.arange(len(uavs)), 0.0, np.expm1(answer.delay.clip(0.0)))
    return _Reading(head, leader, root, delay, silent, softmax(answer.leader, axis=1))


def _read_neighbourhoods(weights: Weights, window: Window, uavs: Indices) -> _Reading:
    """Read ``uavs`` of a window by neighbourhoods.

    A UAV that is read in several is a head if it is one in any; nobody leads if nobody does in the least silent one.
    """
    whole = _Reading(*np.zeros((4, len(uavs))), silent=1.0)
    whole = whole._replace(leader=whole.leader.astype(np.int64), root=whole.root.astype(np.int64))
    for members, own in cut_swarm(window.velocity[:, uavs], window.velocity_seen[:, uavs]):
        found = _read_dense(weights, window, uavs[members])
        whole.head[members] = np.maximum(whole.head[members], found.head)
        whole.leader[members[own]], whole.root[members[own]] = members[found.leader[own]], members[found.root[own]]
        whole.delay[members[own]] = found.delay[own]
        whole = whole._replace(silent=min(whole.silent, found.silent))
    return whole
