"""The learned detector: a network that was shown who heads many simulated swarms; the labelled upper reference."""

from __future__ import annotations

from typing import Annotated

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field

from detectors.base import Detector
from detectors.follow_mixture.policy import Policy, choose
from detectors.learned.inputs import make_inputs
from detectors.learned.network import HeadNetwork, build_network
from detectors.weights import packaged_arrays, read_arrays
from usnet_env.config import ArgumentError, Config, unknown_name
from usnet_env.detection import Detection
from usnet_env.window import Window

__all__ = ["MOST_UAVS", "POLICIES", "Learned", "load_network"]

MOST_UAVS = 1500  # memory grows with their square: 3.5 GB here, and half a minute
_DECIMALS = 6  # of a probability; what differs less is a tie, not the rounding of sums in another order


POLICIES = ("cost", "threshold", "map")


class _Arguments(Config):
    policy: str
    threshold: Annotated[float, Field(ge=0, le=1)]
    round_price: Annotated[float, Field(gt=0)]
    weights: str


class Learned(Detector):
    """Heads named by a permutation-equivariant network that was trained with labels, on random follow strategies.

    Every ordered pair of UAVs gets statistics of how far the one's past tells the other's present
    (:mod:`detectors.learned.features`); attention over UAVs makes of them a probability of being a head for each
    (:mod:`detectors.learned.network`). The strategies that it was trained on hold none of f1 to f7. No other detector
    here was told who the heads are: it stands beside them as the reference of what labels are worth.

    Time and memory grow with N²: 0.07 s at N = 82, seconds and more than a gigabyte at N = 1,000.

    Args:
        policy: ``"cost"``: the candidates that cost least under P2, expected by the probabilities
            (:func:`detectors.follow_mixture.policy.choose`), at least one; ``"threshold"``: those whose probability is
            above ``threshold``, and the most probable UAV where nobody's is; ``"map"``: those who are more likely heads
            than not, perhaps nobody.
        threshold: from 0 to 1; plays a part in ``"threshold"`` only.
        round_price: what one more round is expected to cost, in rounds; plays a part in ``"cost"`` only.
        weights: ``"shipped"``, or a weights file of :func:`detectors.learned.train.train_heads`.

    Raises:
        ArgumentError: from :meth:`reset` and :meth:`detect`: an argument is refused, or the weights file is missing,
            broken, or not what the JSON beside it says.
    """

    def __init__(
        self, policy: str = "cost", threshold: float = 0.5, round_price: float = 1.0, weights: str = "shipped"
    ) -> None:
        self.policy = policy
        self.threshold = threshold
        self.round_price = round_price
        self.weights = weights

    def _arguments(self) -> _Arguments:
        arguments = _Arguments(**self.get_params())
        if arguments.policy not in POLICIES:
            raise unknown_name("policy", arguments.policy, POLICIES)
        return arguments

    def reset(self, seed: int | None = None) -> None:
        """Start an episode; the generator serves to break ties only.

        Raises:
            ArgumentError: an argument of the constructor is refused.
        """
        self._network = load_network(self._arguments().weights)
        super().reset(seed)

    def detect(self, window: Window) -> Detection:
        """Name the heads of one window.

        Returns:
            Candidates; scores, the probabilities of being a head; ``leader``, whom each UAV most probably follows (a
            head and a UAV that follows nobody: itself; -1: destroyed) and ``clusters``, one for each leader;
            attention, the probability that UAV i follows j; in ``extras`` ``probability`` ``(N,)``.

        Raises:
            ArgumentError: an argument of the constructor is refused, or more than ``MOST_UAVS`` live.
        """
        arguments = self._arguments()
        if not hasattr(self, "_network"):
            self.reset()
        living = np.flatnonzero(window.alive)
        if len(living) > MOST_UAVS:
            raise ArgumentError(
                f"window must hold at most {MOST_UAVS} living UAVs for this detector, got {len(living)}."
            )
        probability, attention = np.zeros(window.uavs), np.zeros((window.uavs, window.uavs))
        leader = np.full(window.uavs, -1, np.int64)
        clusters = np.full(window.uavs, -1, np.int64)
        if len(living):
            probability[living], following = _predict_probabilities(self._network, window, living)
            attention[np.ix_(living, living)] = following
            leader[living] = living[following.argmax(axis=1)]
            clusters[living] = np.unique(leader[living], return_inverse=True)[1]
        candidates = _choose_candidates(probability, window.alive, arguments, self.rng.random(window.uavs))
        return Detection(candidates, probability, clusters, leader, attention, {"probability": probability})


def load_network(weights: str = "shipped") -> HeadNetwork:
    """The network with the shipped weights or those of a file, in the mode of use.

    Raises:
        ArgumentError: the file is missing, broken, or not what the JSON beside it says.
    """
    if weights == "shipped":
        return build_network("learned.safetensors", packaged_arrays("detectors.learned", "learned"))
    return build_network(weights, read_arrays(weights))


def _predict_probabilities(
    network: HeadNetwork, window: Window, living: NDArray[np.intp]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Probabilities ``(n,)`` of being a head, and ``(n, n)`` of UAV i following j, itself meaning nobody."""
    with torch.no_grad():
        answer = network(*make_inputs(window, living))
        head = torch.sigmoid(answer.head.double())
        following = torch.softmax(answer.leader.double(), dim=1)
    return head.numpy().round(_DECIMALS), following.numpy()


def _choose_candidates(
    probability: NDArray[np.float64], alive: NDArray[np.bool_], arguments: _Arguments, tie: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """The candidates ``(N,)``, living UAVs only."""
    if arguments.policy == "cost":
        return choose(probability, alive, Policy(round_price=arguments.round_price), tie)
    if arguments.policy == "map":
        return choose(probability, alive, Policy(policy="map"), tie)
    named = alive & (probability > arguments.threshold)
    if not named.any() and alive.any():
        living = np.flatnonzero(alive)
        named[living[np.lexsort((tie[living], -probability[living]))[0]]] = True
    return named
