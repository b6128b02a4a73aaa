"""The answers of the recorded build."""

import pandas as pd
import pytest
from golden import FOLDER, QUICK, detect, differing_rows, list_cells, make_tracks, play_cell, read_answers

ROWS = pd.read_csv(FOLDER / "rows.csv.gz")


def recorded(name, detectors):
    return ROWS[(ROWS.cell == name) & ROWS.detector.isin(detectors)]


@pytest.mark.parametrize("name", ["controls-v2/bystanders", "sensing-v2/tracker", "field-v2/couzin"])
def test_rows_are_those_of_the_recorded_build(name):
    rows = recorded(name, QUICK)
    assert differing_rows(rows[rows.episode == 0], play_cell(name, QUICK, 1)) == []


def test_detect_says_what_the_recorded_build_said(tmp_path):
    answers = read_answers((FOLDER / "detect.json").read_text(encoding="utf-8"))
    found = detect(make_tracks(tmp_path))
    assert len(found) == 4
    assert found == {name: answers[name] for name in found}


@pytest.mark.slow
@pytest.mark.parametrize(("name", "detectors", "episodes"), list(list_cells()))
def test_all_rows_are_those_of_the_recorded_build(name, detectors, episodes):
    assert differing_rows(recorded(name, detectors), play_cell(name, detectors, episodes)) == []
