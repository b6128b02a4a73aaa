"""Every detector that ships passes the conformance checks, as a detector of a plugin must; so does the example."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from registered import NAMES, made

from detectors import Detector
from detectors.checks import check_detector

EXAMPLE = Path(__file__).parents[2] / "examples" / "custom_detector"


@pytest.mark.parametrize("name", NAMES)
def test_a_registered_detector_passes_all_checks(name):
    detector = made(name)
    assert isinstance(detector, Detector)
    assert {result.status for result in check_detector(detector)} == {"passed"}


def test_the_example_passes_the_checks(monkeypatch):
    monkeypatch.syspath_prepend(EXAMPLE)
    assert {result.status for result in check_detector("most_copied:MostCopied(votes=1)")} == {"passed"}


@pytest.mark.slow
def test_the_example_installs_passes_the_checks_and_is_found(tmp_path):
    for path in EXAMPLE.iterdir():  # a copy: building leaves files behind
        if path.is_file():
            (tmp_path / path.name).write_text(path.read_text(encoding="utf-8"), encoding="utf-8")
    site = tmp_path / "site"
    path = os.pathsep.join([str(site), *filter(None, [os.environ.get("PYTHONPATH")])])

    def run(*words):
        done = subprocess.run(
            [sys.executable, *words],
            cwd=tmp_path,
            env={**os.environ, "PYTHONPATH": path},
            capture_output=True,
            text=True,
        )
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    offline = ["-q", "--no-deps", "--no-build-isolation", "--no-index"]
    run("-m", "pip", "install", *offline, "--target", str(site), ".")
    assert "8 checks: 8 passed" in run("-m", "usnet_env", "check-detector", "most-copied(votes=1)")
    assert "most-copied" in run("rank.py")
