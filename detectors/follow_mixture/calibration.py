"""Converts the log-odds of a fit to calibrated probabilities of being a head: a slope, an offset and a doubt.

The three numbers are in ``data/calibration.json``; :mod:`detectors.follow_mixture.train` estimates them off line on
random strategies. The slope is the temperature of the evidence (Platt scaling). The doubt is the share of fits that are
wrong as a whole: their errors come together, however strong the evidence is.
"""

from __future__ import annotations

import json
from functools import cache
from importlib.resources import files
from typing import Annotated

import numpy as np
from pydantic import Field
from scipy.special import expit

from usnet_env.arrays import Floats
from usnet_env.config import Config

MOST_ODDS = 14.0  # log-odds are clipped at this value


class Calibration(Config):
    """The map sigmoid(slope * log-odds + offset), for a fit that is right, and the ``doubt`` that it is.

    If a fit is wrong as a whole, all UAVs are equally likely heads.
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
    return Calibration(**json.loads(source.read_text(encoding="utf-8"))["calibration"])
