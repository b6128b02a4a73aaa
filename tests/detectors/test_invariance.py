"""Copies of a window that differ in nothing a detector may use: scaled, shifted, rotated, planar."""

from dataclasses import replace

import numpy as np
import pytest
from registered import NAMES, made
from scipy.stats import special_ortho_group
from synthetic_windows import answer, flight, window_of

from usnet_env.detection import read_tags

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
