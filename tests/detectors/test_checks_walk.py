"""The walk from nothing to a ranked table: written from the page, in an empty folder, command by command."""

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from detectors.checks import CHECKS
from usnet_env.cli import main

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "examples" / "custom_detector"
STEP = re.compile(
    r"(?:`(?P<path>[\w/]+\.(?:py|toml))`[^`\n]*\n\n)?^```(?P<kind>py|toml|shell)\n(?P<text>.*?)^```$",
    re.MULTILINE | re.DOTALL,
)
PAGE = ROOT / "docs" / "plugging_in.md"
HEADING = re.compile(r"^#+ (?:Plug in: f|F)rom nothing to a ranked table\n", re.MULTILINE)
# pip without the network, and without an environment of its own: what it installs lies in a folder of the test.
PIP = [
    sys.executable,
    "-m",
    "pip",
    "install",
    "-q",
    "--no-deps",
    "--no-build-isolation",
    "--no-index",
    "--target",
    "site",
]


def steps():
    """The files and commands of the walk, in order."""
    _, walk = HEADING.split(PAGE.read_text(encoding="utf-8"))
    return [match.groupdict() for match in STEP.finditer(walk)]


def printed_table():
    """The ranked table as the page shows it."""
    return re.search(r"^```text\n(place .*?)^```$", PAGE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)[1]


def example_files():
    return {path.name: path.read_text(encoding="utf-8") for path in EXAMPLE.iterdir() if path.is_file()}


def command(line):
    """What the page says, as it runs here."""
    words = shlex.split(line, comments=True)
    if words[:2] == ["pip", "install"]:
        return [*PIP, *words[2:]]
    programs = {"usnet": [sys.executable, "-m", "usnet_env"], "python": [sys.executable]}
    return [*programs[words[0]], *words[1:]]


@pytest.fixture
def run(tmp_path):
    def runner(words):
        variables = {
            **os.environ,
            "PYTHONPATH": os.pathsep.join([str(tmp_path / "site"), *filter(None, [os.environ.get("PYTHONPATH")])]),
        }
        return subprocess.run(words, cwd=tmp_path, env=variables, capture_output=True, text=True, timeout=300)

    return runner


def test_the_page_shows_the_example_as_it_is():
    shown = {step["path"]: step["text"] for step in steps() if step["kind"] != "shell"}
    assert shown == {f"custom_detector/{name}": text for name, text in example_files().items()}


@pytest.mark.slow
def test_the_walk(run, tmp_path):
    walk, printed = steps(), {}
    (tmp_path / "custom_detector").mkdir()
    for step in walk:
        if step["kind"] != "shell":
            (tmp_path / step["path"]).write_text(step["text"], encoding="utf-8")
            continue
        for line in step["text"].splitlines():
            done = run(command(line))
            assert done.returncode == 0, f"{line}\n{done.stdout}{done.stderr}"
            printed[" ".join(shlex.split(line, comments=True))] = done.stdout
    (checked,) = [text for line, text in printed.items() if line.startswith("usnet check-detector")]
    assert f"{len(CHECKS)} checks: {len(CHECKS)} passed" in checked
    if listed := printed.get("usnet list detectors"):
        assert re.search(r"^most-copied +Every UAV votes", listed, re.MULTILINE)
    assert printed["python custom_detector/rank.py"] == printed_table()


def test_the_package_installs_and_its_detector_is_found_and_plays(run, tmp_path):
    (tmp_path / "custom_detector").mkdir()
    for name, text in example_files().items():  # a copy: building leaves files behind
        (tmp_path / "custom_detector" / name).write_text(text, encoding="utf-8")
    installed = run([*PIP, "./custom_detector"])
    assert installed.returncode == 0, installed.stdout + installed.stderr
    words = ["evaluate", "--detector", "most-copied(clusters=3)", "--detector", "random", "--episodes", "2"]
    small = ["--set", "clusters=3", "uavs=20", "observation_steps=60"]
    evaluated = run([sys.executable, "-m", "usnet_env", *words, *small])
    assert evaluated.returncode == 0, evaluated.stderr
    assert "most-copied(clusters=3)" in evaluated.stdout


def test_without_the_package_the_name_is_unknown(capsys):
    assert main(["evaluate", "--detector", "most-copied", "--episodes", "1"]) == 2
    assert "detector must be one of" in capsys.readouterr().err
