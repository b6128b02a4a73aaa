"""Every detector that ships passes the conformance checks, as a detector of a plugin must."""

import warnings
from importlib.metadata import distribution

import pytest

from detectors import Detector
from detectors.checks import check_detector, parametrize_with_checks
from usnet_env import ArgumentError, make_detector

# Made small where the defaults train for long: what is checked doesn't depend on the number of steps.
SMALL = {
    "gassl": "gassl(steps=1)",
    "mc-gassl": "mc-gassl(gassl={'steps': 1})",
    "neural-granger": "neural-granger(steps=2, times=8, voters=3)",
    "lead-votes": "lead-votes(gate_steps=2, passes=1)",
}
# Detectors that can't pass a check: by the name of the detector, the check and the reason.
EXPECTED = {}
NAMES = sorted(point.name for point in distribution("usnet").entry_points if point.group == "usnet.detectors")
SECONDS = 60.0  # of a machine that does much else; each detector's own speed is measured by the benchmarks


def made(name):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            detector = make_detector(SMALL.get(name, name))
            if name == "lead-votes":
                detector.set_params(head_detector=make_detector(SMALL["neural-granger"]))
            return detector
        except ArgumentError as error:  # its extra is not installed
            pytest.skip(str(error))


def test_the_baselines_are_registered():
    assert {"random", "destroy-all", "none", "lagged-correlation", "lagged-regression", "one-per-round"} <= set(NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_a_registered_detector_is_a_detector(name):
    assert isinstance(made(name), Detector)


@pytest.mark.parametrize("name", NAMES)
def test_a_registered_detector_passes_all_checks(name):
    results = check_detector(made(name), expected_failed_checks=EXPECTED.get(name), seconds=SECONDS)
    assert {result.check for result in results if result.status == "expected failure"} == set(EXPECTED.get(name, ()))
    assert not [result.check for result in results if result.status == "skipped"]


@pytest.mark.slow
@parametrize_with_checks([make_detector("neural-granger(steps=2, times=4, gate=True)")], seconds=SECONDS)
def test_neural_granger_with_its_gate(detector, check):
    check(detector)
