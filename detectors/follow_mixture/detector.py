"""The follow-mixture detector: groups of UAVs that move together, and the UAVs whose pasts predict these groups."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field
from scipy.special import expit

from detectors.base import Detector
from detectors.follow_mixture.calibration import shipped_calibration
from detectors.follow_mixture.fit import Fit, fit_motion
from detectors.follow_mixture.motion import read_motion
from detectors.parameters import Count, Lags, Seconds, check_clusters, count_lags
from detectors.policy import choose
from detectors.series.direction import lead_probabilities
from usnet_env.detection import Detection, Tags
from usnet_env.window import Window


class FollowMixture(Detector):
    """Finds all heads: which UAV's past predicts each group of UAVs that move together, beyond the group's own past.

    UAVs that move simultaneously form groups: the followers of one head do. A group follows a candidate if the
    candidate's past adds to the group's own past as a predictor. Heads are chosen together, with one law that all
    groups share or a law of each group's own. The result is a probability of each UAV of being a head, from which the
    policy chooses the candidates. docs/follow_mixture.md describes the method.

    Args:
        clusters: the largest number of heads, and of candidates, or ``None``; the number of heads is estimated.
        memory: the number of past velocities of a head that the strategy may use, at least 1.
        max_lag: the longest individual delay of a follower, in samples; a quarter of the window at most.
        max_delay: the longest delay in seconds instead; the window must know its step. ``None``: ``max_lag`` holds.
        policy: how candidates are chosen from the probabilities.

            * ``"cost"`` (default) minimises the expected J_m (J_s for ``objective="P1"``). A missed head costs another
              round and a redundant candidate only 1/N of a round; so it also names doubtful UAVs. Where the detector
              believes that no UAV follows, it therefore names all UAVs. It names at least one UAV.
            * ``"map"`` names only probable heads: the UAVs with a probability of being a head above 1/2. It may name
              no UAV.
        objective: ``"P2"`` (destroy all heads in few rounds) or ``"P1"`` (name the single head in one round).
        shot_budget: the largest number of candidates per round, or ``None``.
        redundancy_price: the cost of a redundant candidate, in units of the objective (1/N of a round in P2).
        round_price: the cost of one more round of P2. ``None``: 1 if a UAV is a probable head, and N / 4 if none is,
            so that heads could only be guessed.

    Raises:
        ArgumentError: from :meth:`reset` and :meth:`detect`, if an argument is refused.
    """

    tags = Tags(takes_clusters=True)

    clusters: Count | None = None
    memory: Annotated[int, Field(ge=1, le=64)] = 4
    max_lag: Lags = 12
    max_delay: Seconds | None = None
    policy: Literal["cost", "map"] = "cost"
    objective: Literal["P1", "P2"] = "P2"
    shot_budget: Count | None = None
    redundancy_price: Annotated[float, Field(ge=0)] = 1.0
    round_price: Annotated[float, Field(gt=0)] | None = None

    def detect(self, window: Window) -> Detection:
        """Name the heads of one window.

        Returns:
            Candidates by the policy, scores (log-odds of being a head; a doubtful direction lowers those of its whole
            tree), clusters and leader (the direct one, a head or a relay); in ``extras``: ``root`` ``(N,)``, the head
            of each UAV (-1: none); ``relay`` ``(N,)`` bool, UAVs that lead and follow; ``probability`` ``(N,)``, if the
            fit is right, and ``doubt``, that it is not; ``gain`` ``(N,)``, the log-likelihood that the UAV's group
            gains by its head, in nats; ``group`` ``(N,)``, the group of each living UAV, -1 for others; ``heads``
            (indices), ``reasons`` (one sentence per head, with its most probable lag in samples) and ``direction``
            (log-likelihood ratio of each: that it leads, against a common cause); ``strategy`` (feature class, weights
            of the shared law, noise) or ``None``; ``nats``, the gain of the whole fit less the prices.

        Raises:
            ArgumentError: an argument of the constructor is refused, ``clusters`` exceeds the window's N, or the window
                doesn't know the step that ``max_delay`` needs.
        """
        arguments = self.check_arguments()
        check_clusters(window, arguments.clusters)
        rng = self.rng
        living = np.flatnonzero(window.alive)
        most = 1 if arguments.objective == "P1" else arguments.clusters
        motion = read_motion(window, living)
        longest = count_lags(window, arguments.max_lag, arguments.max_delay)
        found = None if motion is None else fit_motion(motion, arguments.memory, longest, most, rng)
        probability, gain = np.zeros(window.uavs), np.zeros(window.uavs)
        leader, root, clusters, group = np.full((4, window.uavs), -1, np.int64)
        extras: dict[str, Any] = {"strategy": None, "reasons": [], "nats": 0.0, "direction": np.empty(0)}
        extras["heads"] = np.empty(0, np.int64)
        probability[living] = 1.0 / (len(living) + 1.0)  # if no UAV seems to follow another one
        doubt, ranked = 0.0, probability
        if found is not None:
            calibration = shipped_calibration()
            doubt, leads = calibration.doubt, np.maximum(calibration(found.log_odds), expit(found.relays[1]))
            probability[living] = leads * expit(-found.relays[0])
            direction, led = lead_probabilities(found.leads), found.root >= 0
            tree = np.searchsorted(found.heads, found.root[led])
            ranked = probability.copy()  # a doubtful direction lowers a tree; among clear ones, it ranks no head
            ranked[living[led]] *= np.minimum(2.0 * direction, 1.0)[tree]
            probability[living[found.heads]] *= direction
            heads = living[found.heads]
            leader[living] = np.where(found.leader >= 0, living[found.leader], -1)
            root[living] = np.where(found.root >= 0, living[found.root], -1)
            leader[heads] = heads
            clusters[living[led]] = tree
            gain[living], group[living] = found.gain, found.group
            extras |= {
                "strategy": {"features": found.features, "law": found.law, "noise": found.noise},
                "heads": heads,
                "reasons": _give_reasons(found),
                "nats": found.value,
                "direction": found.leads,
            }
        scores = np.zeros(window.uavs)
        odds = np.clip(ranked[living], 1e-12, 1 - 1e-12)
        scores[living] = np.log(odds) - np.log1p(-odds)
        if found is not None:
            scores[window.alive] -= scores[window.alive].min()
        extras |= {"probability": probability, "doubt": doubt, "gain": gain, "group": group, "root": root}
        extras["relay"] = np.isin(np.arange(window.uavs), leader) & (leader >= 0) & (leader != np.arange(window.uavs))
        candidates = choose(probability, window.alive, arguments, rng.random(window.uavs), doubt, arguments.clusters)
        return Detection(candidates=candidates, scores=scores, clusters=clusters, leader=leader, extras=extras)


def _give_reasons(found: Fit) -> list[str]:
    """One sentence per head: how many UAVs its past predicts, in how many groups, at which lag, and the evidence."""
    reasons = []
    for head, lag in zip(found.heads, found.lag, strict=True):
        behind = found.leader == head
        groups, first = np.unique(found.group[behind], return_index=True)
        nats, count, through = found.gain[behind][first].sum(), int(behind.sum()), int((found.root == head).sum()) - 1
        where = f" in {len(groups)} groups" if len(groups) > 1 else ""
        when = f" at lag {lag}" if lag else ""
        more = f"; {through - count} more through others" if through > count else ""
        who = f"{count} follower{'s' if count > 1 else ''}{where}"
        reasons.append(f"Its past predicts {who}{when} (evidence {nats:.0f} nats){more}.")
    return reasons
