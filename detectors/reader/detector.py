"""The reader as a detector: a network that learned from simulated swarms who leads."""

from __future__ import annotations

from functools import cached_property
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field
from scipy.special import expit, softmax

from detectors.base import Detector
from detectors.policy import choose_candidates
from detectors.reader.features import LEAST_STRIDED, make_features
from detectors.reader.forward import Answer, Weights, load_reader, predict
from detectors.reader.neighbourhoods import cut_swarm, gather_doubtful
from detectors.series.exchanges import undo_exchanges
from usnet_env.arrays import Indices, Mask, Singles
from usnet_env.detection import Detection, Tags
from usnet_env.window import Window

_MOST_AT_ONCE = 200  # UAVs that are read as one window; a larger swarm is read in neighbourhoods
_CLEAR = -0.01  # logarithm of the probability of a set of heads from which on a window is read once
_DECIMALS = 6  # of a probability: smaller differences are rounding errors, and count as ties


class Reader(Detector):
    """Names heads by a network that was trained with labels on 57 families of simulated windows.

    f1 to f7 and the laws of the suite ``open`` are no families. The network reads statistics of every ordered pair of
    UAVs, and needs no PyTorch. More than 200 UAVs are read in neighbourhoods of UAVs that move alike.

    Args:
        policy: ``"cost"`` (default) names the set with the least expected cost, none where probably no UAV leads (see
            :func:`detectors.policy.choose_candidates`); ``"map"`` names the UAVs with a probability above 1/2.
        objective: ``"P2"`` (destroy all heads in few rounds) or ``"P1"`` (name the single head in one round).
        round_price: the expected cost of one more round of P2, in rounds; used by ``"cost"`` only.
        weights: ``"shipped"``; to compare with, ``"untrained"`` (random) and ``"blind"`` (trained on windows of the
            same prior without any feature of a pair); or a weights file of ``usnet train reader``.

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
            probability that UAV i's motion depends on UAV j's itself (``None`` of more than 200). In ``extras``:
            ``root`` ``(N,)``, the head of each UAV; ``delay`` ``(N,)``, steps behind the leader; ``p_no_leader``, the
            probability that no UAV leads; ``confidence``, that the UAVs with a probability above 1/2 are exactly the
            heads. A UAV that follows none in its own neighbourhood may be a head in another one; doubtful heads are
            read again beside the probable ones. No UAV leads if none does in any neighbourhood.
        """
        window = undo_exchanges(window)
        flying = np.flatnonzero(window.velocity.any(axis=(0, 2)))
        probability, guest_probability, unled_probability, delay = np.zeros((4, window.uavs))
        leader, root, clusters = np.full((3, window.uavs), -1, np.int64)
        attention = np.zeros((window.uavs, window.uavs)) if len(flying) <= _MOST_AT_ONCE else None
        p_no_leader, neighbourhoods = 1.0, _divide_uavs(window, flying)

        def keep_answer(answer: Answer[Any], uavs: Indices, mask: Mask) -> None:
            """Keep what an answer says of some of its UAVs."""
            probability[uavs[mask]] = answer.head[mask]
            leader[uavs[mask]], root[uavs[mask]] = (
                uavs[logits.argmax(axis=1)[mask]] for logits in (answer.leader, answer.root)
            )
            delay[uavs[mask]] = answer.delay[mask]

        for uavs, core in neighbourhoods:
            answer = self._read_twice(window, uavs, core)
            keep_answer(answer, uavs, core)
            unled_probability[uavs[core]] = softmax(answer.leader, axis=1).diagonal()[core]
            guest_probability[uavs[~core]] = np.maximum(guest_probability[uavs[~core]], answer.head[~core])
            p_no_leader = min(p_no_leader, round(float(expit(np.float64(answer.silent))), _DECIMALS))
            if attention is not None:
                attention[np.ix_(uavs, uavs)] = expit(answer.link.astype(np.float64)) * ~np.eye(len(uavs), dtype=bool)
        probability[:] = np.maximum(probability, unled_probability * guest_probability)
        for uavs, core in gather_doubtful(probability, root) if len(neighbourhoods) > 1 else ():
            answer = self._read_twice(window, uavs, core)
            keep_answer(answer, uavs, core & (answer.head < probability[uavs]))
        probability = probability.round(_DECIMALS)
        delay[leader == np.arange(window.uavs)] = 0.0
        clusters[root >= 0] = np.unique(root[root >= 0], return_inverse=True)[1]
        rule = {name: getattr(self, name) for name in ("policy", "objective", "round_price")}
        candidates = choose_candidates(probability, window.alive, self.rng.random(window.uavs), p_no_leader, **rule)
        confidence = float(np.maximum(probability, 1.0 - probability).prod())
        extras = {"probability": probability, "root": root, "delay": delay, "confidence": confidence}
        extras |= {"p_no_leader": p_no_leader, "silent": p_no_leader}  # silent: its name in version 0.1
        return Detection(candidates, probability, clusters, leader, attention, extras)

    def _read_twice(self, window: Window, uavs: Indices, core: Mask) -> Answer[Any]:
        """The answer for some UAVs, with probabilities of being a head, and delays in steps.

        A doubtful one is compared with that at every second step. The one with the likelier set of heads in the
        ``core`` ``(m,)`` counts.
        """
        answers = list[tuple[float, Answer[Any]]]()
        for stride in (1, 2) if len(window.velocity) >= LEAST_STRIDED else (1,):
            answer = predict(self._weights, make_features(*_take_samples(window, uavs, stride)))
            head = answer.head.astype(np.float64)
            log_probability = float(-np.logaddexp(0.0, -np.abs(head[core])).sum())
            delay = stride * np.expm1(answer.delay.clip(0.0))
            answers.append((log_probability, answer._replace(head=expit(head), delay=delay)))
            if log_probability > _CLEAR:
                break
        return max(answers, key=lambda pair: pair[0])[1]


def _take_samples(window: Window, uavs: Indices, stride: int) -> tuple[Singles, Singles, Mask]:
    """Positions, velocities and what is seen of some UAVs, at every so many samples."""
    position, seen = window.position[::stride, uavs], window.seen[::stride, uavs]
    if stride == 1:
        return position, window.velocity[:, uavs], seen
    both_seen = (seen[1:] & seen[:-1])[..., None]
    return position, np.where(both_seen, np.diff(position, axis=0), np.float32(0.0)), seen


def _divide_uavs(window: Window, flying: Indices) -> list[tuple[Indices, Mask]]:
    """The sets of UAVs that are read at once, and for which of them, the core, the answer counts."""
    if len(flying) < 2:
        return []
    if len(flying) <= _MOST_AT_ONCE:
        return [(flying, np.ones(len(flying), bool))]
    return [
        (flying[uavs], core) for uavs, core in cut_swarm(window.velocity[:, flying], window.velocity_seen[:, flying])
    ]
