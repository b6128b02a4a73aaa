"""Calibration of follow-mixture: maps that rise, a file that is checked, a training that goes on where it was."""

import json
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from detectors.checks.windows import simulate_window
from detectors.follow_mixture import FollowMixture
from detectors.follow_mixture.calibration import (
    VERDICTS,
    Calibration,
    Curve,
    calibrated,
    read_calibration,
    shipped_calibration,
    verdict,
)
from detectors.follow_mixture.explanation import KINDS, Explanation
from detectors.follow_mixture.train import (
    COLUMNS,
    CalibrationTraining,
    draw_swarm,
    fit_calibration,
    read_rows,
    train_calibration,
)
from detectors.policy import Policy, choose
from usnet_env.config import ArgumentError
from usnet_env.swarm.follow import FollowInputs, follow_strategy
from usnet_env.swarm.random_follow import RandomFollowStrategy

SHIPPED = files("detectors.follow_mixture") / "data" / "calibration.json"
ROWS = Path(__file__).parents[3] / "benchmarks" / "results" / "follow_mixture_calibration.csv.gz"
TINY = CalibrationTraining(swarms=4, most_uavs=24, most_clusters=3)

finite = st.floats(-20, 20)
shares = st.lists(st.floats(0, 1), min_size=2, max_size=20)


class Interrupted(Exception):
    """Stands for whatever ends a training early."""


def record():
    return json.loads(SHIPPED.read_text(encoding="utf-8"))


def explanation(probability=(0.9, 0.1, 0.0), passed=(), kind=None):
    n = len(probability) if kind is None else len(kind)
    raw = np.zeros(n) if kind is not None else np.array(probability)
    heads = np.arange(len(passed))
    kinds = None if kind is None else np.array(kind)
    nothing = np.zeros(n)
    return Explanation(
        heads, np.full(n, -1), raw, raw, nothing, nothing, kind=kinds, passed=np.array(passed, dtype=bool)
    )


@given(st.floats(0.01, 20), finite, shares)
def test_curves_rise(slope, offset, probability):
    mapped = Curve(slope=slope, offset=offset)(np.sort(probability))
    assert ((mapped >= 0) & (mapped <= 1)).all()
    assert (np.diff(mapped) >= 0).all()


@pytest.mark.parametrize("said", VERDICTS)
@given(shares)
def test_calibrated_posteriors_rise_and_are_probabilities(said, probability):
    passed = {"phases": [True], "firm": [True], "partly": [True, False], "weak": [False], "nobody": []}[said]
    found = replace(explanation(np.sort(probability), passed), by_phases=said == "phases")
    assert verdict(found) == said
    plain, sure, doubt = calibrated(found)
    for mapped in (plain, sure):
        assert ((mapped >= 0) & (mapped <= 1)).all()
        assert (np.diff(mapped) >= 0).all()
    assert 0 <= doubt < 1


def test_a_mixture_gives_the_rates_of_its_kinds():
    plain, sure, doubt = calibrated(explanation(kind=[0, 1, 2, 3, 4, 5], passed=[True, False]))
    shipped = shipped_calibration()
    assert plain.tolist() == [getattr(shipped.probability.rates, KINDS[k]) for k in range(6)]
    assert sure.tolist() == [getattr(shipped.given.rates, KINDS[k]) for k in range(6)]
    assert doubt == 0
    assert plain[0] > 0.95
    assert plain[2] < 0.01


def test_what_ships_holds_and_says_how_it_was_made(tmp_path):
    made = record()
    assert read_calibration(str(SHIPPED)) == shipped_calibration()
    draws = {name: made["training"][name] for name in CalibrationTraining.model_fields}
    assert CalibrationTraining(**draws) == CalibrationTraining()  # what the command makes by default
    assert made["metrics"]["log loss, flocks"] < made["metrics"]["log loss, flocks before"]
    firm, weak = (getattr(shipped_calibration().given.curves, said) for said in ("firm", "weak"))
    assert firm.trust > weak.trust


def test_committed_rows_give_what_ships():
    fitted, shipped = fit_calibration(read_rows(ROWS)).model_dump(), shipped_calibration().model_dump()
    for belief in ("probability", "given"):
        assert fitted[belief]["rates"] == pytest.approx(shipped[belief]["rates"], abs=2e-6)
        for said in VERDICTS:
            assert fitted[belief]["curves"][said] == pytest.approx(shipped[belief]["curves"][said], abs=2e-3)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (
            lambda made: made["calibration"]["given"]["curves"]["firm"].update(slope=-1.0),
            "slope must be greater than 0",
        ),
        (lambda made: made["calibration"]["given"]["curves"]["firm"].update(trust=1.5), "trust must be"),
        (lambda made: made["calibration"]["given"]["rates"].update(passed=1.0), "passed must be less than 1"),
        (lambda made: made["calibration"]["given"]["rates"].update(more=0.5), "more is not an argument"),
        (lambda made: made["calibration"]["given"]["rates"].pop("alone"), "alone must be"),
        (lambda made: made["calibration"].pop("given"), "given must be"),
        (lambda made: made.pop("calibration"), "path must hold a calibration as JSON"),
    ],
)
def test_a_bad_calibration_is_refused_in_one_sentence(tmp_path, change, sentence):
    made = record()
    change(made)
    path = tmp_path / "calibration.json"
    path.write_text(json.dumps(made))
    with pytest.raises(ArgumentError, match=sentence) as refused:
        read_calibration(path)
    assert str(refused.value).startswith("path must hold a calibration")
    assert str(refused.value).count(".\n") == 0


@pytest.mark.parametrize("text", ["", "[]", '{"calibration": 3}', '{"calibration": {"given": 3}}'])
def test_something_else_is_no_calibration(tmp_path, text):
    path = tmp_path / "calibration.json"
    path.write_text(text)
    with pytest.raises(ArgumentError, match="path must hold a calibration as JSON"):
        read_calibration(path)
    with pytest.raises(ArgumentError, match="path must be a calibration file"):
        read_calibration(tmp_path / "missing.json")


@pytest.mark.slow
def test_interrupted_training_goes_on_to_the_identical_result(tmp_path):
    def stop(done, total):
        if done == 3:
            raise Interrupted

    whole = train_calibration(tmp_path / "whole", TINY)
    few = train_calibration(tmp_path / "parts", TINY.model_copy(update={"swarms": 2}))
    with pytest.raises(Interrupted):
        train_calibration(tmp_path / "parts", TINY, stop)
    assert len(read_rows(tmp_path / "parts" / "rows.csv")) == 2
    calls = []
    parts = train_calibration(tmp_path / "parts", TINY, lambda *call: calls.append(call))
    assert calls == [(3, 4), (4, 4)]
    assert few == parts
    for name in ("calibration.json", "rows.csv", "reliability.csv"):
        assert (whole.parent / name).read_bytes() == (parts.parent / name).read_bytes()
    assert isinstance(read_calibration(whole), Calibration)
    with pytest.raises(ArgumentError, match="out must hold no rows of other draws"):
        train_calibration(tmp_path / "parts", TINY.model_copy(update={"seed": 1}))
    anew = train_calibration(tmp_path / "parts", TINY.model_copy(update={"seed": 1}), resume=False)
    assert whole.read_bytes() != anew.read_bytes()
    (tmp_path / "parts" / "rows.csv").write_text("swarm\n1\n")
    with pytest.raises(ArgumentError, match="path must hold rows of this calibration"):
        read_rows(tmp_path / "parts" / "rows.csv")
    with pytest.raises(ArgumentError, match="path must be a file of rows"):
        read_rows(tmp_path / "parts" / "none.csv")


def test_swarms_are_of_every_kind_and_follow_no_strategy_of_the_paper():
    drawn = [draw_swarm(CalibrationTraining(), np.random.default_rng([0, swarm])) for swarm in range(300)]
    assert all(config.follow == "none" or isinstance(config.follow, RandomFollowStrategy) for config in drawn)
    assert 10 < sum(config.follow == "none" for config in drawn) < 60
    assert {config.mobility for config in drawn} >= {"iid", "gauss_markov", "straight", "waypoint"}
    assert min(config.uavs for config in drawn) >= 20
    assert max(config.uavs for config in drawn) <= 150
    for name in ("decoys", "miss_rate", "position_noise", "head_jitter"):
        assert 0 < sum(bool(getattr(config, name)) for config in drawn) < 300


def test_the_calibration_never_draws_f1():
    """Strategies that are alike on all axes have no rotation, which is what keeps the others apart from f1."""
    rng = np.random.default_rng(0)
    head_velocity = rng.standard_normal((50, 4, 3)).astype(np.float32)
    head_velocity /= np.linalg.norm(head_velocity, axis=-1, keepdims=True)
    positions = rng.uniform(0, 500, (2, 50, 5, 3)).astype(np.float32)
    inputs = FollowInputs(positions[0], head_velocity, positions[1], np.empty(0, np.float32))
    f1 = follow_strategy("f1").direction(inputs)
    alike, nearest = 0, -1.0
    for swarm in range(400):  # the first swarms of the calibration that ships
        follow = draw_swarm(CalibrationTraining(), np.random.default_rng([0, swarm])).follow
        if follow == "none":
            continue
        wanted = follow.direction(inputs)
        lengths = np.linalg.norm(wanted, axis=1) * np.linalg.norm(f1, axis=1)
        nearest = max(nearest, float(np.mean((wanted * f1).sum(axis=1) / lengths)))
        alike += follow.rotation is not None and np.array_equal(follow.rotation, np.eye(3))
    assert alike > 20
    assert nearest < 0.995  # the mean cosine of two strategies that the grammar's own test takes for different


def row(swarm, way, follows=1, **entries):
    entries = {"living": "20", "heads": "2", "kinds": "", "probability": "", "given": ""} | entries
    return dict.fromkeys(COLUMNS, "") | {"swarm": str(swarm), "way": way, "follows": str(follows)} | entries


def test_fits_find_what_was_put_in():
    mixtures = [row(n, "mixture", kinds="passed:2:2 follower:17:0 alone:1:0") for n in range(50)]
    rates = fit_calibration(mixtures).probability.rates
    assert rates.passed == pytest.approx((100 + 0.1) / 101, abs=1e-5)
    assert rates.follower == pytest.approx(0.1 / 851, abs=1e-5)
    assert rates.missing == pytest.approx(0.1)  # never seen: as likely as anybody
    # Log-odds of +-3 that are right in a half of the swarms, and worth nothing in the other.
    right = [row(n, "firm", given="44:18:0 68:2:2", probability="44:18:0 68:2:2") for n in range(40)]
    wrong = [row(n, "firm", given="44:18:2 68:2:0", probability="44:18:2 68:2:0") for n in range(40)]
    fitted = fit_calibration([*right, *wrong])
    assert fitted.given.curves.firm.trust == pytest.approx(0.5, abs=0.1)
    assert fitted.given.curves.firm(np.array([0.95]))[0] > 0.9
    assert fitted.probability.curves.firm(np.array([0.9526]))[0] == pytest.approx(0.5, abs=0.05)
    silent = [row(n, "weak", follows=0, heads="0", given="68:20:0", probability="68:20:0") for n in range(40)]
    alarmed = fit_calibration([*right, *silent])
    assert alarmed.probability.curves.weak(np.array([0.95]))[0] < 0.05
    assert alarmed.given.curves.weak.slope == 1  # nothing seen of it where somebody leads


def test_doubt_stands_for_misses_that_come_together():
    alive, tie, p = np.ones(200, bool), np.zeros(200), np.full(200, 0.002)
    p[:5] = 0.97
    dear = Policy(round_price=1.2)
    assert choose(p, alive, dear, tie).sum() == 5
    assert choose(p, alive, dear, tie, doubt=0.5).sum() == 5
    apart = 0.5 * p + 0.5 * p.mean()
    assert choose(apart, alive, dear, tie).sum() == 200  # the same probabilities, taken for independent
    assert choose(p, alive, Policy(policy="map"), tie, doubt=0.3).sum() == 5
    assert choose(p, alive, Policy(policy="map"), tie, doubt=0.6).sum() == 0
    assert choose(p, alive, Policy(objective="P1"), tie, doubt=0.3).sum() == 1


def test_probabilities_of_the_detector_are_calibrated():
    detector = FollowMixture()
    detector.reset(0)
    probability = detector.detect(simulate_window(2, 12)).extras["probability"]
    assert ((probability >= 0) & (probability <= 1)).all()
