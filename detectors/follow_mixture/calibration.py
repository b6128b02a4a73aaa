"""From what an explanation says to probabilities: shares of heads that were counted off line, on random strategies.

The numbers lie in ``data/calibration.json``; :mod:`detectors.follow_mixture.train` makes them. A mixture puts every UAV
into one of a few kinds, whose shares of heads were counted. Flocks give a posterior, whose log-odds are scaled and
shifted (Platt), by how many of the explanation's heads passed their gates: nothing else tells as well how far it can be
believed.
"""

from __future__ import annotations

import json
import os
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.special import expit, logit

from detectors.follow_mixture.explanation import KINDS, Explanation
from usnet_env.config import ArgumentError, Config, quote

__all__ = [
    "MOST_ODDS",
    "VERDICTS",
    "Belief",
    "Calibration",
    "Curve",
    "Curves",
    "Rates",
    "calibrated",
    "log_odds",
    "read_calibration",
    "shipped_calibration",
    "verdict",
]

Floats = NDArray[np.float64]

#: Phases of flights told the heads. Or how many of an explanation's heads passed: all, some, none; or nobody was named.
VERDICTS = ("phases", "firm", "partly", "weak", "nobody")

MOST_ODDS = 14.0  # a posterior's log-odds say nothing more beyond this

Share = Annotated[float, Field(gt=0, lt=1)]


class Rates(Config):
    """Share of heads among UAVs of each kind, see :data:`detectors.follow_mixture.explanation.KINDS`.

    Args:
        passed: heads of a mixture whose gate passed.
        failed: whose gate failed.
        follower: who follows one.
        stray: one of few that are left over beside a strategy that misfits, and nobody could follow it.
        missing: left over beside one, otherwise.
        alone: left over beside one that holds.
    """

    passed: Share
    failed: Share
    follower: Share
    stray: Share
    missing: Share
    alone: Share


class Curve(Config):
    """sigmoid(slope * log-odds + offset), which rises.

    Args:
        slope: positive.
        offset: of the log-odds.
        left: added to the log-odds of those whom the explanation leaves over.
        trust: that the explanation is right as a whole. Else every UAV is as likely a head as any other.
    """

    slope: Annotated[float, Field(gt=0)]
    offset: float
    left: float = 0.0
    trust: Annotated[float, Field(gt=0, le=1)] = 1.0

    def __call__(self, probability: Floats, left: NDArray[np.bool_] | bool = False) -> Floats:
        """The map, elementwise, of probabilities from 0 to 1; ``trust`` is not in it."""
        shift = self.offset + self.left * np.asarray(left, np.float64)
        return np.asarray(expit(self.slope * log_odds(probability) + shift), np.float64)


class Curves(Config):
    """A curve for every verdict, see :data:`VERDICTS`."""

    phases: Curve
    firm: Curve
    partly: Curve
    weak: Curve
    nobody: Curve


class Belief(Config):
    """For both ways of explaining a swarm.

    Args:
        rates: of a mixture.
        curves: of flocks.
    """

    rates: Rates
    curves: Curves


class Calibration(Config):
    """What an explanation's words are worth.

    Args:
        probability: of being a head.
        given: of being a head given that somebody leads, and how far the explanation can be trusted as a whole.
    """

    probability: Belief
    given: Belief


def log_odds(probability: Floats) -> Floats:
    """Log-odds, at most :data:`MOST_ODDS` either way."""
    return np.asarray(np.clip(logit(np.clip(probability, 0.0, 1.0)), -MOST_ODDS, MOST_ODDS), np.float64)


def verdict(found: Explanation) -> str:
    """One of :data:`VERDICTS`."""
    if found.by_phases:
        return "phases"
    if not len(found.passed):
        return "nobody"
    return "firm" if found.passed.all() else "partly" if found.passed.any() else "weak"


def calibrated(found: Explanation, calibration: Calibration | None = None) -> tuple[Floats, Floats, float]:
    """Probabilities of n UAVs.

    Args:
        found: the explanation.
        calibration: by default the one that ships.

    Returns:
        ``(n,)`` of being a head; ``(n,)`` of being a head if somebody leads and the explanation is right as a whole;
        and the probability that it is wrong.
    """
    calibration = shipped_calibration() if calibration is None else calibration
    if found.kind is not None:
        probability, given = (
            np.array([getattr(belief.rates, kind) for kind in KINDS])[found.kind]
            for belief in (calibration.probability, calibration.given)
        )
        return probability, given, 0.0
    said = verdict(found)
    curve: Curve = getattr(calibration.given.curves, said)
    plain: Curve = getattr(calibration.probability.curves, said)
    left = False if found.left is None else found.left
    return plain(found.probability, left), curve(found.given, left), 1.0 - curve.trust


@cache
def shipped_calibration() -> Calibration:
    """The calibration in the package."""
    source = files("detectors.follow_mixture") / "data" / "calibration.json"
    return _parsed(source.read_text(encoding="utf-8"), source.name)


def read_calibration(path: str | os.PathLike[str]) -> Calibration:
    """The calibration in a file that ``usnet train follow-mixture`` wrote.

    Raises:
        ArgumentError: the file is missing, or holds something else.
    """
    try:
        text = Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise ArgumentError(f"path must be a calibration file, got {quote(str(path))}: {reason}.") from None
    return _parsed(text, str(path))


def _parsed(text: str, path: str) -> Calibration:
    try:
        beliefs = json.loads(text)["calibration"]
        return Calibration(**{name: _belief(belief) for name, belief in beliefs.items()})
    except ArgumentError as error:
        raise ArgumentError(f"path must hold a calibration, got {quote(path)}: {str(error).rstrip('.')}.") from None
    except (ValueError, KeyError, TypeError, AttributeError):
        raise ArgumentError(f"path must hold a calibration as JSON, got {quote(path)}.") from None


def _belief(entries: dict[str, Any]) -> Belief:
    curves = {name: Curve(**curve) for name, curve in entries["curves"].items()}
    return Belief(rates=Rates(**entries["rates"]), curves=Curves(**curves))
