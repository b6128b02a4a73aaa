"""All registered detectors, made small where the defaults train for long."""

import warnings
from importlib.metadata import distribution

import pytest

from usnet_env import ArgumentError, make_detector

SMALL = {
    "gassl": "gassl(steps=1)",
    "mc-gassl": "mc-gassl(gassl={'steps': 1}, count=2)",
    "neural-granger": "neural-granger(steps=2, times=8, voters=3)",
}
NAMES = sorted(point.name for point in distribution("usnet").entry_points if point.group == "usnet.detectors")


def made(name):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            return make_detector(SMALL.get(name, name))
        except ArgumentError as error:  # its extra is not installed
            pytest.skip(str(error))
