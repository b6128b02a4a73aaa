"""Converts the result of a fit to calibrated probabilities of being a head.

The parameters are in ``data/calibration.json``; :mod:`detectors.follow_mixture.train` estimates them off line on random
strategies. A mixture fit puts each UAV into one of a few categories; its probability is the share of heads in the
category. A flock fit gives a posterior; its log-odds are scaled and shifted (Platt scaling). Which curve applies
depends on how many heads of the fit passed their test, the best indicator of its reliability.
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

#: Reliability classes of a flock fit: heads from cross-spectral phases; all, some or none of the heads passed their
#: test; or no head was found.
VERDICTS = ("phases", "firm", "partly", "weak", "nobody")

MOST_ODDS = 14.0  # the log-odds of a posterior are clipped at this value

Share = Annotated[float, Field(gt=0, lt=1)]


class Rates(Config):
    """Share of true heads in each category, see :data:`detectors.follow_mixture.explanation.KINDS`.

    Args:
        passed: heads of a mixture that passed their test.
        failed: heads of a mixture that failed their test.
        follower: followers.
        stray: unassigned UAVs that can't have followers, where few are unassigned and the strategy misfits.
        missing: the other unassigned UAVs where the strategy misfits.
        alone: unassigned UAVs where the strategy fits.
    """

    passed: Share
    failed: Share
    follower: Share
    stray: Share
    missing: Share
    alone: Share


class Curve(Config):
    """The increasing map sigmoid(slope * log-odds + offset).

    Args:
        slope: the slope, positive.
        offset: added to the log-odds.
        left: added to the log-odds of unassigned UAVs.
        trust: the probability that the fit is right as a whole. If it is wrong, all UAVs are equally likely heads.
    """

    slope: Annotated[float, Field(gt=0)]
    offset: float
    left: float = 0.0
    trust: Annotated[float, Field(gt=0, le=1)] = 1.0

    def __call__(self, probability: Floats, left: NDArray[np.bool_] | bool = False) -> Floats:
        """Apply the map to probabilities from 0 to 1, without ``trust``."""
        shift = self.offset + self.left * np.asarray(left, np.float64)
        return np.asarray(expit(self.slope * log_odds(probability) + shift), np.float64)


class Curves(Config):
    """One curve per reliability class, see :data:`VERDICTS`."""

    phases: Curve
    firm: Curve
    partly: Curve
    weak: Curve
    nobody: Curve


class Belief(Config):
    """The parameters for both kinds of fit.

    Args:
        rates: for mixture fits.
        curves: for flock fits.
    """

    rates: Rates
    curves: Curves


class Calibration(Config):
    """The parameters of the calibration.

    Args:
        probability: for the probability of being a head.
        given: for the same probability, conditional on the presence of a head, with the trust in the whole fit.
    """

    probability: Belief
    given: Belief


def log_odds(probability: Floats) -> Floats:
    """Log-odds, clipped at plus and minus :data:`MOST_ODDS`."""
    return np.asarray(np.clip(logit(np.clip(probability, 0.0, 1.0)), -MOST_ODDS, MOST_ODDS), np.float64)


def verdict(found: Explanation) -> str:
    """The reliability class of a flock fit, one of :data:`VERDICTS`."""
    if found.by_phases:
        return "phases"
    if not len(found.passed):
        return "nobody"
    return "firm" if found.passed.all() else "partly" if found.passed.any() else "weak"


def calibrated(found: Explanation, calibration: Calibration | None = None) -> tuple[Floats, Floats, float]:
    """Compute calibrated probabilities of n UAVs.

    Args:
        found: the result of a fit.
        calibration: the parameters; by default those of the package.

    Returns:
        ``(n,)`` probabilities of being a head; ``(n,)`` the same if there is a head and the fit is right as a whole;
        and the probability that the fit is wrong.
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
    """Read the calibration of the package."""
    source = files("detectors.follow_mixture") / "data" / "calibration.json"
    return _parsed(source.read_text(encoding="utf-8"), source.name)


def read_calibration(path: str | os.PathLike[str]) -> Calibration:
    """Read a calibration file written by ``usnet train follow-mixture``.

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
