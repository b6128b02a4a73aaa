"""One interface for everything that can be evaluated: an agent is reset, then answers one observation a round."""

from __future__ import annotations

import copy
import time
from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np

from usnet_env.config import ArgumentError, named_values, quote
from usnet_env.detection import Detection, ask
from usnet_env.parts import named_parameters, parse_label
from usnet_env.plugins import DETECTORS, detector_label, make_detector
from usnet_env.window import Window

#: The trivial policies that every published table also shows: decision (l) of ``docs/game.md``.
TRIVIAL = ("destroy-all", "none", "random", "one-per-round")

#: What has the methods ``reset(seed)``, ``answer(observation)``, which returns a detection and its seconds, and
#: ``warm_up(observation)``, which answers without being timed, so that compiling does not count as time of an episode.
Agent: TypeAlias = Any


class DetectorAgent:
    """A detector as an agent: it receives a :class:`usnet_env.Window` made from the observation, and nothing else."""

    def __init__(self, detector: Any) -> None:
        self.detector = detector

    def reset(self, seed: int) -> None:
        """Start an episode."""
        self.detector.reset(seed)

    def answer(self, observation: Any) -> tuple[Detection, float]:
        """Return what is scored of the detector's answer; only the call of ``detect`` is timed."""
        found, seconds = ask(self.detector, Window.from_observation(observation))
        return Detection(found.candidates, found.scores, found.clusters), seconds

    def warm_up(self, observation: Any) -> None:
        """Answer once with a copy of the detector."""
        try:
            detector = copy.deepcopy(self.detector)
        except Exception:  # it cannot be copied; its reset must then discard what it learns here
            detector = self.detector
        agent = DetectorAgent(detector)
        agent.reset(0)
        agent.answer(observation)


class PolicyAgent:
    """An object with the ``predict`` method of Stable-Baselines3, called with ``deterministic=True``.

    Its candidates serve as scores. Its own random numbers are not seeded here. An argument ``action_masks`` receives
    the mask of the UAVs that are alive. A model that was trained behind ``VecNormalize`` receives normalised
    observations, with the means and variances that it had at the end of its training.
    """

    def __init__(self, policy: Any) -> None:
        self.policy = policy
        self._masked = "action_masks" in named_parameters(policy.predict)
        normaliser = getattr(policy, "get_vec_normalize_env", lambda: None)()
        self._normaliser = normaliser if getattr(normaliser, "norm_obs", True) else None
        self.reset(0)

    def reset(self, seed: int) -> None:
        """Start an episode with an empty state; the seed is not used."""
        self._state: Any = None
        self._start = True

    def answer(self, observation: Any) -> tuple[Detection, float]:
        """Return the policy's action; only the call of ``predict`` is timed."""
        seen = observation if self._normaliser is None else self._normaliser.normalize_obs(observation)
        given: dict[str, Any] = {}
        if self._masked:  # (2 N,): 0 is allowed for every UAV, 1 for those that are alive
            alive = np.asarray(observation["alive"], bool)
            given["action_masks"] = np.stack([np.ones(len(alive), bool), alive], axis=1).ravel()
        begin = time.perf_counter()
        action, self._state = self.policy.predict(
            seen, state=self._state, episode_start=np.array([self._start]), deterministic=True, **given
        )
        seconds = time.perf_counter() - begin
        self._start = False
        values = np.asarray(action)
        uavs = len(observation["alive"]) if isinstance(observation, Mapping) else values.size
        if values.shape != (uavs,) or not np.isin(values, (0, 1)).all():
            raise ArgumentError(f"predict must return an action of {uavs} values 0 and 1, got {quote(action)}.")
        return Detection(values, values), seconds

    def warm_up(self, observation: Any) -> None:
        """Answer once and discard the state that ``predict`` returns."""
        PolicyAgent(self.policy).answer(observation)


def as_agent(detector: Any) -> Agent:
    """Wrap a detector, its name, or an object with ``predict``, as an agent; anything else is refused."""
    if isinstance(detector, str):
        detector = make_detector(detector)
    if not isinstance(detector, type):
        if all(callable(getattr(detector, name, None)) for name in ("detect", "reset")):
            return DetectorAgent(detector)
        if callable(getattr(detector, "predict", None)):
            return PolicyAgent(detector)
    raise ArgumentError(
        f"detector must be a name, an object with detect and reset, or an object with predict, got {quote(detector)}."
    )


def find_label(given: Any) -> str:
    """The label of what is a detector's name, a detector or a policy."""
    return detector_label(given) if isinstance(given, str) or hasattr(type(given), "detect") else type(given).__name__


def check_labels(argument: str, labels: Sequence[str]) -> None:
    """Refuse labels that are missing, equal or not printable."""
    if not labels or len({*labels}) < len(labels) or not all(label and label.isprintable() for label in labels):
        raise ArgumentError(f"{argument} must have different labels of printable characters, got {quote(labels)}.")


def label_detectors(detector: Any, trivial: bool, isolated: bool) -> dict[str, Any]:
    """Give each detector its own label; refuse what can't be a detector, and a name or argument that no detector has.

    A constructor that fails is no wrong argument: the detector's rows have the reason. ``isolated`` says that detectors
    that are given by name are made in their own processes only.
    """
    if isinstance(detector, Mapping):
        named = named_values("detector", detector)
        labels, several = list(named), list(named.values())
    else:
        several = list(detector) if isinstance(detector, list | tuple) else [detector]
        labels = [find_label(given) for given in several]
    check_labels("detector", labels)
    found = dict(zip(labels, several, strict=True))
    found |= {name: name for name in TRIVIAL if trivial and name not in found}
    for given in found.values():
        try:
            if not isolated or not isinstance(given, str):
                as_agent(given)
            elif ":" not in (name := parse_label(given, {})[0]):
                DETECTORS.find(name)
        except (ArgumentError, ImportError):
            raise
        except (Exception, SystemExit):  # the constructor of another package may raise anything
            continue
    return found
