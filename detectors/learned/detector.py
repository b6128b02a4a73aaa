"""The learned detector: a network that was trained on simulated swarms with known heads."""

from __future__ import annotations

from functools import cached_property
from typing import Annotated, Any, Literal

import numpy as np
import torch
from pydantic import Field

from detectors.base import Detector
from detectors.learned.features import make_inputs
from detectors.learned.network import HeadNetwork, build_network
from detectors.policy import Policy, choose
from detectors.series.designs import check_pairs
from detectors.weights import packaged_arrays, read_arrays
from usnet_env.arrays import Floats, Mask
from usnet_env.detection import Detection, Tags
from usnet_env.window import Window

MOST_UAVS = 1500  # memory grows with the square: 3.5 GB and half a minute at this number
_DECIMALS = 6  # of a probability: smaller differences are rounding errors, and count as ties


class Learned(Detector):
    """Names heads by a permutation-equivariant network, trained with labels on random follow strategies.

    Statistics of every ordered pair of UAVs measure how well the past of one predicts the velocity of the other
    (:mod:`detectors.learned.features`). A network with attention over UAVs computes from them the probability of each
    UAV of being a head (:mod:`detectors.learned.network`), and the policy chooses candidates from the probabilities.
    None of f1 to f7 is among the strategies of the training. The training uses the true heads of the simulated swarms;
    so the detector serves as a reference for what labels are worth.

    Time and memory grow with N²: 0.2 s at N = 82, 15 s and more than a gigabyte at N = 1,000.

    Args:
        policy: how candidates are chosen. ``"cost"`` (default) minimises the expected J_m of P2
            (:func:`detectors.policy.choose`) and names at least one UAV; ``"map"`` names the UAVs with a probability
            above 1/2, possibly none; ``"threshold"`` those above ``threshold``, or the most probable UAV.
        threshold: from 0 to 1; used by ``"threshold"`` only.
        round_price: the expected cost of one more round, in rounds, above 0; used by ``"cost"`` only.
        weights: ``"shipped"``, or the path of a weights file of :func:`detectors.learned.train.train_heads`.

    Raises:
        ArgumentError: from :meth:`reset` and :meth:`detect`: an argument is refused, the weights file is missing or
            broken, or more than 1,500 UAVs are alive.
    """

    tags = Tags(needs=("torch",), most_uavs=1500)
    _made_by_reset = "_network"  # a broken file is refused there

    policy: Literal["cost", "threshold", "map"] = "cost"
    threshold: Annotated[float, Field(ge=0, le=1)] = 0.5
    round_price: Annotated[float, Field(gt=0)] = 1.0
    weights: str = "shipped"

    @cached_property
    def _network(self) -> HeadNetwork:
        return load_network(self.check_arguments().weights)

    def detect(self, window: Window) -> Detection:
        """Name the heads of one window.

        Returns:
            Candidates; scores and ``extras["probability"]``, the probabilities of being a head; ``leader``, the UAV
            that each UAV most probably follows (its own index: none; -1: destroyed); ``clusters``, one per leader;
            attention, the probability that UAV i follows UAV j.
        """
        arguments = self.check_arguments()
        check_pairs(window.uavs)
        living = np.flatnonzero(window.alive)
        check_pairs(len(living), MOST_UAVS)
        probability, attention = np.zeros(window.uavs), np.zeros((window.uavs, window.uavs))
        leader, clusters = np.full((2, window.uavs), -1, np.int64)
        if len(living):
            with torch.no_grad():
                answer = self._network(*make_inputs(window, living))
            probability[living] = torch.sigmoid(answer.head.double()).numpy().round(_DECIMALS)
            following = torch.softmax(answer.leader.double(), dim=1).numpy()
            if not window.velocity_seen.any():  # equal inputs, of which rounding must not make an order
                probability[living] = probability[living].mean()
            attention[np.ix_(living, living)] = following
            leader[living] = living[following.argmax(axis=1)]
            clusters[living] = np.unique(leader[living], return_inverse=True)[1]
        candidates = _choose_candidates(probability, window.alive, arguments, self.rng.random(window.uavs))
        return Detection(candidates, probability, clusters, leader, attention, {"probability": probability})


def load_network(weights: str = "shipped") -> HeadNetwork:
    """Load the network with the shipped weights or those of a file, in evaluation mode."""
    if weights == "shipped":
        return build_network("learned.safetensors", packaged_arrays("detectors.learned", "learned"))
    return build_network(weights, read_arrays(weights))


def _choose_candidates(probability: Floats, alive: Mask, arguments: Any, tie: Floats) -> Mask:
    """Choose the candidates ``(N,)`` among the living UAVs by the policy."""
    if arguments.policy != "threshold":
        policy = Policy(policy=arguments.policy, round_price=arguments.round_price)
        return choose(probability, alive, policy, tie)
    named = alive & (probability > arguments.threshold)
    if not named.any() and alive.any():
        named[np.lexsort((tie, -probability, ~alive))[0]] = True
    return named
