"""Every registered detector answers any window, or refuses it in one sentence; a batch changes no answer."""

import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from registered import NAMES, made
from synthetic_windows import unit, window_of

from usnet_env import ArgumentError, Window


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
def test_a_swarm_with_too_many_pairs_is_refused(name):
    ones = np.ones((7, 10_001))
    window = Window(np.zeros((7, 10_001, 3)), np.zeros((6, 10_001, 3)), ones, ones[0])
    with pytest.raises(ArgumentError, match="window must hold at most 10000 UAVs"):
        made(name).detect(window)
