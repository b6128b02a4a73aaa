"""One interface for detectors here and in child processes: an agent is reset, then answers one observation a round."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from typing import Any, TypeAlias

from usnet_env.config import ArgumentError, named_values, quote
from usnet_env.detection import Detection, ask
from usnet_env.parts import parse_label
from usnet_env.plugins import DETECTORS, detector_label, find_detector
from usnet_env.window import Window

#: The trivial policies that every published table also shows: decision (l) of ``docs/game.md``.
TRIVIAL = ("destroy-all", "none", "random", "one-per-round")

#: What has the methods ``reset(seed)``, ``answer(observation)``, which returns a detection and its seconds, and
#: ``warm_up(observation)``, which answers without being timed, so that compiling does not count as time of an episode.
Agent: TypeAlias = Any


class DetectorAgent:
    """A detector, or that of a name, as an agent: it receives a :class:`usnet_env.Window` and nothing else."""

    def __init__(self, detector: Any) -> None:
        self.detector = find_detector(detector)

    def reset(self, seed: int) -> None:
        """Start an episode."""
        self.detector.reset(seed)

    def answer(self, observation: Any) -> tuple[Detection, float]:
        """Return what is scored of the detector's answer; only the call of ``detect`` is timed."""
        detection, seconds = ask(self.detector, Window.from_observation(observation))
        return Detection(detection.candidates, detection.scores, detection.clusters), seconds

    def warm_up(self, observation: Any) -> None:
        """Answer once with a copy of the detector."""
        try:
            detector = copy.deepcopy(self.detector)
        except Exception:  # it cannot be copied; its reset must then discard what it learns here
            detector = self.detector
        agent = DetectorAgent(detector)
        agent.reset(0)
        agent.answer(observation)


def label_detectors(detector: Any, trivial: bool, isolated: bool) -> dict[str, Any]:
    """Give each detector its own label; refuse what can't be a detector, and a name or argument that no detector has.

    A constructor that fails is no wrong argument: the detector's rows have the reason. ``isolated`` says that detectors
    that are given by name are made in their own processes only.
    """
    if isinstance(detector, Mapping):
        by_label = named_values("detector", detector)
        labels, detectors = list(by_label), list(by_label.values())
    else:
        detectors = list(detector) if isinstance(detector, list | tuple) else [detector]
        labels = [
            detector_label(each) if isinstance(each, str) or hasattr(type(each), "detect") else "" for each in detectors
        ]
    if not labels:
        raise ArgumentError(f"detector must name at least one, got {quote(detector)}.")
    labelled = dict(zip(labels, detectors, strict=True))
    labelled |= {name: name for name in TRIVIAL if trivial and name not in labels}
    for candidate in labelled.values():
        try:
            if not isolated or not isinstance(candidate, str):
                find_detector(candidate)
            elif ":" not in (name := parse_label(candidate, {})[0]):
                DETECTORS.find(name)
        except (ArgumentError, ImportError):
            raise
        except (Exception, SystemExit):  # the constructor of another package may raise anything
            continue
    if len({*labels}) < len(labels) or not all(label and label.isprintable() for label in labels):
        raise ArgumentError(f"detector must have different labels of printable characters, got {quote(labels)}.")
    return labelled
