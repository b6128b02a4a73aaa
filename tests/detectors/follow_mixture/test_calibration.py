"""Calibration of follow-mixture: the map, its file, its training and the policy that uses it."""

import itertools
import json
from importlib.resources import files

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from interrupted_training import Interrupted, stop_at
from scipy.special import expit

from detectors.follow_mixture.calibration import Calibration
from detectors.follow_mixture.train import (
    CalibrationTraining,
    fit_calibration,
    train_calibration,
)
from detectors.policy import Policy, choose
from usnet_env.config import ArgumentError

SHIPPED = files("detectors.follow_mixture") / "data" / "calibration.json"
TINY = CalibrationTraining(swarms=4, most_uavs=24, most_clusters=3)


def record():
    return json.loads(SHIPPED.read_text(encoding="utf-8"))


@given(st.floats(0.01, 20), st.floats(-20, 20), st.lists(st.floats(-20, 20), min_size=2, max_size=20))
def test_probabilities_rise_with_the_log_odds(slope, offset, odds):
    mapped = Calibration(slope=slope, offset=offset)(np.array([-np.inf, *sorted(odds), np.inf]))
    assert ((mapped >= 0) & (mapped <= 1)).all()
    assert (np.diff(mapped) >= 0).all()


def test_what_ships_was_made_by_the_defaults():
    made = record()
    draws = {name: made["training"][name] for name in CalibrationTraining.model_fields}
    assert CalibrationTraining(**draws) == CalibrationTraining()
    assert made["metrics"]["log loss"] <= made["metrics"]["log loss, before calibration"]


def rows_of(slope, offset, doubt, swarms=300, uavs=60):
    """Rows of swarms whose heads are drawn by a calibration; log-odds have bins of 0.25, the first of them at -14."""
    rng = np.random.default_rng(0)
    rows = []
    for _ in range(swarms):
        place = rng.integers(30, 83, uavs)
        share = expit(slope * (0.25 * place - 14.0) + offset)
        head = rng.random(uavs) < (share if rng.random() >= doubt else share.mean())
        counts = ((k, (place == k).sum(), head[place == k].sum()) for k in np.unique(place))
        rows.append(" ".join(":".join(map(str, entry)) for entry in counts))
    return pd.DataFrame({"log_odds": rows})


@pytest.mark.parametrize(("slope", "offset", "doubt"), [(0.5, 0.0, 0.0), (1.0, -1.5, 0.3), (2.0, 1.0, 0.1)])
def test_slope_offset_and_doubt_are_recovered_from_counts(slope, offset, doubt):
    fitted = fit_calibration(rows_of(slope, offset, doubt))
    assert fitted.slope == pytest.approx(slope, rel=0.1)
    assert fitted.offset == pytest.approx(offset, abs=0.15)
    assert fitted.doubt == pytest.approx(doubt, abs=0.06)


@given(st.integers(0, 10_000), st.floats(0.0, 3.0))
@settings(max_examples=30)
def test_the_policy_has_the_least_expected_cost(seed, price):
    rng = np.random.default_rng(seed)
    probability = rng.beta(0.3, 0.5, 6)
    alive = np.ones(6, bool)
    named = choose(probability, alive, Policy(redundancy_price=price, round_price=1.0), rng.random(6))

    def cost(some):
        rest = np.setdiff1d(np.arange(6), some)
        return 1.0 - np.prod(1.0 - probability[rest]) + price / 6 * (1.0 - probability[list(some)]).sum()

    costs = [cost(some) for count in range(1, 7) for some in itertools.combinations(range(6), count)]
    assert cost(np.flatnonzero(named)) == pytest.approx(min(costs), abs=1e-9)


def test_the_policy_keeps_to_its_budget_and_to_the_living():
    probability = np.array([0.9, 0.8, 0.7, 0.2])
    alive = np.array([True, False, True, True])
    tie = np.zeros(4)
    assert choose(probability, alive, Policy(shot_budget=1), tie).tolist() == [True, False, False, False]
    assert choose(probability, alive, Policy(policy="map"), tie).tolist() == [True, False, True, False]
    assert choose(probability, alive, Policy(objective="P1"), tie).tolist() == [True, False, False, False]
    assert not choose(np.full(4, 0.1), alive, Policy(policy="map"), tie).any()
    assert choose(np.full(4, 0.001), alive, Policy(), tie).sum() >= 1
    assert not choose(probability, np.zeros(4, bool), Policy(), tie).any()


def test_interrupted_training_is_resumed_to_the_identical_result(tmp_path):
    whole = train_calibration(tmp_path / "whole", TINY)
    with pytest.raises(Interrupted):
        train_calibration(tmp_path / "parts", TINY, stop_at(2))
    rows = tmp_path / "parts" / "rows.csv"
    assert len(pd.read_csv(rows)) == 2
    calls = []
    parts = train_calibration(tmp_path / "parts", TINY, lambda *call: calls.append(call))
    assert calls == [(3, 4), (4, 4)]
    for name in ("calibration.json", "rows.csv"):
        assert (whole.parent / name).read_bytes() == (parts.parent / name).read_bytes()
    with pytest.raises(ArgumentError, match="out must hold no rows of other settings"):
        train_calibration(tmp_path / "parts", TINY.model_copy(update={"seed": 1}))
    shorter = train_calibration(tmp_path / "parts", TINY.model_copy(update={"swarms": 2}))
    assert json.loads(shorter.read_text())["metrics"]["uavs"] == pd.read_csv(rows)["living"][:2].sum()


def test_without_evidence_the_map_is_the_identity():
    fitted = fit_calibration(pd.DataFrame({"log_odds": [""]}))
    assert (fitted.slope, fitted.offset) == (1.0, 0.0)
