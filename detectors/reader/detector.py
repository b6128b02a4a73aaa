"""The reader as a detector: a network that learned from simulated swarms who leads."""

from __future__ import annotations

from functools import cached_property
from typing import Annotated, Literal

import numpy as np
from pydantic import Field
from scipy.special import expit, softmax

from detectors.base import Detector
from detectors.policy import choose
from detectors.reader.features import make_features
from detectors.reader.forward import Weights, load_reader, read
from detectors.reader.neighbourhoods import cut_swarm
from detectors.series.designs import check_pairs
from usnet_env.arrays import Indices, Mask
from usnet_env.detection import Detection, Tags
from usnet_env.window import Window

_DENSE = 200  # UAVs that are read as one window; a larger swarm is read in neighbourhoods
_DECIMALS = 6  # of a probability: smaller differences are rounding errors, and count as ties


class Reader(Detector):
    """Names heads by a network that was trained with labels on 50 families of simulated windows.

    f1 to f7 and the laws of the suite ``open`` are no families. The network reads statistics of every ordered pair of
    UAVs, and needs no PyTorch. More than 200 UAVs are read in neighbourhoods of UAVs that move alike.

    Args:
        policy: ``"cost"`` (default) names the set with the least expected cost (:func:`detectors.policy.choose`),
            nobody where probably nobody leads; ``"map"`` names the UAVs with a probability above 1/2.
        objective: ``"P2"`` (destroy all heads in few rounds) or ``"P1"`` (name the single head in one round).
        round_price: the expected cost of one more round of P2, in rounds; used by ``"cost"`` only.
        weights: ``"shipped"``, ``"untrained"`` (random, to compare with), or a weights file of ``usnet train reader``.

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
            Candidates; scores and ``extras["probability"]``, of being a head; ``leader``, the one followed directly
            (own index: none; -1: destroyed or never seen to move); ``clusters``, one per root; attention, the
            probability that UAV i follows UAV j (``None`` of more than 200). In ``extras``: ``root`` ``(N,)``, the head
            of each UAV; ``delay`` ``(N,)``, steps behind the leader; ``p_no_leader``, the probability that no UAV
            leads; ``confidence``, that the UAVs with a probability above 1/2 are exactly the heads. A UAV that follows
            none in its own neighbourhood may be a head in another one. No UAV leads if none does in any.
        """
        arguments = self.check_arguments()
        check_pairs(window.uavs)
        flying = np.flatnonzero(window.velocity.any(axis=(0, 2)))
        probability, away, free, delay = np.zeros((4, window.uavs))
        leader, root, clusters = np.full((3, window.uavs), -1, np.int64)
        attention = np.zeros((window.uavs, window.uavs)) if len(flying) <= _DENSE else None
        p_no_leader, position, velocity, seen = 1.0, window.position, window.velocity, window.seen
        for uavs, own in _divide_uavs(window, flying):
            answer = read(self._weights, make_features(position[:, uavs], velocity[:, uavs], seen[:, uavs]))
            head, follows = expit(answer.head.astype(np.float64)), softmax(answer.leader, axis=1)
            probability[uavs[own]], free[uavs[own]] = head[own], follows.diagonal()[own]
            away[uavs[~own]] = np.maximum(away[uavs[~own]], head[~own])
            p_no_leader = min(p_no_leader, round(float(expit(np.float64(answer.silent))), _DECIMALS))
            leader[uavs[own]], root[uavs[own]] = (uavs[to.argmax(axis=1)[own]] for to in (answer.leader, answer.root))
            delay[uavs[own]] = np.expm1(answer.delay[own].clip(0.0))
            if attention is not None:
                attention[np.ix_(uavs, uavs)] = follows
        probability = np.maximum(probability, free * away).round(_DECIMALS)
        delay[leader == np.arange(window.uavs)] = 0.0
        clusters[root >= 0] = np.unique(root[root >= 0], return_inverse=True)[1]
        rule = {name: getattr(arguments, name) for name in ("policy", "objective", "round_price")}
        candidates = choose(probability, window.alive, self.rng.random(window.uavs), p_no_leader, **rule)
        confidence = float(np.maximum(probability, 1.0 - probability).prod())
        extras = {"probability": probability, "root": root, "delay": delay, "confidence": confidence}
        extras |= {"p_no_leader": p_no_leader, "silent": p_no_leader}  # silent: its name in version 0.1
        return Detection(candidates, probability, clusters, leader, attention, extras)


def _divide_uavs(window: Window, flying: Indices) -> list[tuple[Indices, Mask]]:
    """The sets of UAVs that are read at once, and for which of them the answer counts."""
    if len(flying) < 2:
        return []
    if len(flying) <= _DENSE:
        return [(flying, np.ones(len(flying), bool))]
    return [(flying[uavs], own) for uavs, own in cut_swarm(window.velocity[:, flying], window.velocity_seen[:, flying])]
