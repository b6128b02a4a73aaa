"""Converts the log-odds of a fit to calibrated probabilities of being a head: a slope, an offset and a doubt.

The three numbers are in ``data/calibration.json``; :mod:`detectors.follow_mixture.train` estimates them off line on
random strategies. The slope is the temperature of the evidence (Platt scaling). The doubt is the share of fits that are
wrong as a whole: their errors come together, however strong the evidence is.
"""

from __future__ import annotations

import json
import os
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field
from scipy.special import expit

from usnet_env.arrays import Floats
from usnet_env.config import ArgumentError, Config, quote

MOST_ODDS = 14.0  # log-odds are clipped at this value


class Calibration(Config):
    """The increasing map sigmoid(slope * log-odds + offset), for a fit that is right, and the doubt that it is.

    Args:
        slope: the slope, positive.
        offset: added to the log-odds.
        doubt: the probability that a fit is wrong as a whole. Then all UAVs are equally likely heads.
    """

    slope: Annotated[float, Field(gt=0, allow_inf_nan=False)]
    offset: Annotated[float, Field(allow_inf_nan=False)]
    doubt: Annotated[float, Field(ge=0, lt=1)] = 0.0

    def __call__(self, log_odds: Floats) -> Floats:
        """Probabilities from log-odds, which may be infinite, if the fit is right."""
        return np.asarray(expit(self.slope * np.clip(log_odds, -MOST_ODDS, MOST_ODDS) + self.offset), np.float64)


@cache
def shipped_calibration() -> Calibration:
    """Read the calibration of the package."""
    source = files("detectors.follow_mixture") / "data" / "calibration.json"
    return _parse(source.read_text(encoding="utf-8"), source.name)


def read_calibration(path: str | os.PathLike[str]) -> Calibration:
    """Read a calibration file written by :func:`detectors.follow_mixture.train.train_calibration`.

    Raises:
        ArgumentError: the file is missing, or holds something else.
    """
    try:
        text = Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise ArgumentError(f"path must be a calibration file, got {quote(str(path))}: {reason}.") from None
    return _parse(text, str(path))


def _parse(text: str, path: str) -> Calibration:
    try:
        return Calibration(**json.loads(text)["calibration"])
    except ArgumentError as error:
        raise ArgumentError(f"path must hold a calibration, got {quote(path)}: {str(error).rstrip('.')}.") from None
    except (ValueError, KeyError, TypeError, AttributeError):
        raise ArgumentError(f"path must hold a calibration as JSON, got {quote(path)}.") from None
