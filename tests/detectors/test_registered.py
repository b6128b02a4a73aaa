"""Every registered detector keeps the contract, answers any window or refuses it, and names a bad argument."""

import os
import subprocess
import sys
import warnings
from dataclasses import replace
from importlib.metadata import distribution
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import special_ortho_group
from synthetic_windows import answer, flight, swarm_window, unit, window_of

from detectors import Detector
from detectors.checks import check_detector
from detectors.mc_gassl.train import MetaTraining
from usnet_env import ArgumentError, Window, make_detector
from usnet_env.detection import read_tags

EXAMPLE = Path(__file__).parents[2] / "examples" / "custom_detector"
NAMES = sorted(point.name for point in distribution("usnet").entry_points if point.group == "usnet.detectors")
SMALL = {  # where the defaults train for long
    "gassl": "gassl(steps=1)",
    "mc-gassl": "mc-gassl(gassl={'steps': 1}, count=2)",
    "neural-granger": "neural-granger(steps=2, times=8, voters=3)",
}


def made(name):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            return make_detector(SMALL.get(name, name))
        except ArgumentError as error:  # its extra is not installed
            pytest.skip(str(error))


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


@st.composite
def windows(draw):
    """Groups of 1 to 4 UAVs, still or moving, with a common drift; tracks begin, end, alternate or are never seen."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    steps, uavs = draw(st.sampled_from([5, 6, 8, 12, 20, 40])), draw(st.integers(1, 12))
    head = np.arange(uavs) // draw(st.integers(1, 4)) * draw(st.integers(1, 4)) % uavs
    fresh = unit(rng.standard_normal((steps + 1, uavs, 3)))
    if draw(st.booleans()):  # smooth
        fresh = unit(np.cumsum(fresh, axis=0) + 1e-9)
    fresh *= rng.random(uavs)[:, None] >= draw(st.sampled_from([0.0, 0.0, 0.5]))  # those do not move
    if draw(st.booleans()):
        fresh[..., 2] = 0.0  # planar
    follows = fresh[:-1, head] + draw(st.sampled_from([0.0, 0.05, 0.5])) * rng.standard_normal((steps, uavs, 3))
    velocity = np.where((head == np.arange(uavs))[:, None], fresh[1:], follows)
    velocity = velocity * draw(st.sampled_from([1e-3, 1.0, 30.0])) + draw(st.sampled_from([0.0, 0.0, 30.0]))
    instants = np.arange(steps + 1)[:, None]
    begin, end = np.sort(rng.integers(0, steps + 2, (2, uavs)), axis=0)
    seen = {
        "all": np.ones((steps + 1, uavs), bool),
        "missed": rng.random((steps + 1, uavs)) < draw(st.sampled_from([0.1, 0.5, 0.9])),
        "come and go": (instants >= begin) & (instants < end),
        "groups come and go": (instants >= begin[head]) & (instants < end[head]),
        "heads leave before followers come": (instants < begin) == (head == np.arange(uavs)),
        "some are never seen": np.broadcast_to(rng.random(uavs) < 0.5, (steps + 1, uavs)),
        "nothing": np.zeros((steps + 1, uavs), bool),
    }[draw(st.sampled_from(["all", "missed", *3 * ["come and go", "groups come and go"], *PATTERNS]))]
    alive = rng.random(uavs) >= draw(st.sampled_from([0.0, 0.0, 0.3]))
    return window_of(velocity, seen, alive, draw(st.integers(1, 3)))


PATTERNS = ["heads leave before followers come", "some are never seen", "nothing"]


def answers_or_refuses(name, window):
    detector = made(name)
    detector.reset(0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            answer = detector.detect(window)
        except ArgumentError as error:
            refusal = str(error)
        else:
            refusal = None
    if refusal is not None:
        assert refusal.endswith(".")
        assert "\n" not in refusal
        return
    assert len(answer.candidates) == window.uavs
    assert not (answer.candidates & ~window.alive).any()
    if not window.velocity_seen.any() and name not in ("random", "central-most"):  # these need no motion
        assert len(np.unique(answer.scores[window.alive])) <= 1


@pytest.mark.parametrize("name", NAMES)
@settings(max_examples=4)
@given(window=windows())
def test_a_detector_answers_tracks_that_come_and_go(name, window):
    answers_or_refuses(name, window)


@pytest.mark.parametrize("name", ["lagged-regression", "flica", "gassl"])
def test_a_swarm_with_too_many_pairs_or_too_few_uavs_is_refused(name):
    ones = np.ones((7, 10_001))
    window = Window(np.zeros((7, 10_001, 3)), np.zeros((6, 10_001, 3)), ones, ones[0])
    with pytest.raises(ArgumentError, match="window must hold at most 10000 UAVs"):
        made(name).detect(window)
    with pytest.raises(ArgumentError, match="clusters must be at most"):
        make_detector("lagged-regression", clusters=31).detect(swarm_window(0, observation_steps=10)[0])


BAD = {
    "random": {"count": 0},
    "central-most": {"reach": 0.0},
    "track-outlier": {"threshold": -1.0},
    "lagged-correlation": {"clusters": 0, "max_lag": None},
    "lagged-regression": {"clusters": 2.5, "lags": "4", "squares": 1, "ridge": float("nan")},
    "granger": {"own_lags": -1},
    "factions": {"max_lag": 0, "threshold": 1.5},
    "directional-delays": {"max_lag": 0},
    "mflica": {"level": 1.0},
    "gassl": {"top_k": 0, "times": "last", "learning_rate": float("inf"), "similarity_hidden": (8, 8, 8), "gain": 0.0},
    "mc-gassl": {"start": "cold", "count": 0, "clusterer": 3},
    "neural-granger": {"steps": 1.5, "gate": 1, "device": "tpu", "voters": 1, "floor": 5e-324},
    "reader": {"policy": "best", "objective": "P3", "round_price": 0.0},
}


@pytest.mark.parametrize(("name", "argument"), [(name, argument) for name, bad in BAD.items() for argument in bad])
def test_a_bad_argument_is_refused(name, argument):
    made(name)
    window, _ = swarm_window(0, observation_steps=10)
    detector = make_detector(name, **{argument: BAD[name][argument]})
    for use in (lambda: detector.reset(0), lambda: detector.detect(window)):
        with pytest.raises(ArgumentError, match=f"^{argument} must "):
            use()


@pytest.mark.parametrize(
    ("use", "bad"),
    [
        *((lambda **bad: make_detector("mc-gassl", gassl=bad).reset(0), {name: 3}) for name in ("memory", "units")),
        *((MetaTraining, bad) for bad in ({"episodes": 0}, {"method": "maml"}, {"seed": -1}, {"inner_rate": 0.0})),
    ],
)
def test_bad_arguments_of_gassl_in_mc_gassl_and_of_a_training_are_refused(use, bad):
    with pytest.raises((ArgumentError, TypeError), match=next(iter(bad))):
        use(**bad)


TURN = special_ortho_group.rvs(3, random_state=1)
PLANAR_TURN = np.array([[0.6, 0.8, 0], [-0.8, 0.6, 0], [0, 0, 1]])
# They square each axis by itself, or train a network on the axes.
ON_AXES = {"gassl", "mc-gassl", "neural-granger", "lagged-regression", "one-per-round"}


@pytest.mark.parametrize("name", [name for name in NAMES if name not in ON_AXES])
@pytest.mark.parametrize("change", ["small", "large", "turned", "planar turned", "moved"])
def test_an_answer_does_not_depend_on_units_axes_or_origin(name, change):
    velocity, _ = flight(np.random.default_rng(5), (4, 3), steps=80)
    if change in ("small", "large") and read_tags(made(name)).needs_unit_speed:
        pytest.skip("it says that it was made for 1 m per step")
    if change == "planar turned":
        velocity = velocity * (1, 1, 0)
    window = window_of(velocity)
    other = {
        "small": lambda: window_of(velocity * 0.01),
        "large": lambda: window_of(velocity * 1000),
        "turned": lambda: window_of(velocity @ TURN.T),
        "planar turned": lambda: window_of(velocity @ PLANAR_TURN.T),
        "moved": lambda: replace(window, position=window.position + np.float32([100, -300, 50])),
    }[change]()
    one, two = (answer(made(name), each, seed=3) for each in (window, other))
    np.testing.assert_array_equal(one.candidates, two.candidates)
    np.testing.assert_allclose(one.scores, two.scores, rtol=0.02, atol=0.02 * np.abs(one.scores).max())
