"""CSV files whose numbers have decimal commas: read where there is no doubt, or where the caller says so."""

import numpy as np
import pytest
from track_files import HEADER, rows_of, straight, write_csv

from usnet_env import ArgumentError
from usnet_env.tracks import read_tracks

ROWS = rows_of(straight())


def comma(number, digits=3):
    return f"{number:.{digits}f}".replace(".", ",")


def refusal(path, **options):
    with pytest.raises(ArgumentError) as caught:
        read_tracks(path, **options)
    return str(caught.value)


@pytest.mark.parametrize("delimiter", [";", "\t", ","])  # cells with commas are quoted where they separate
@pytest.mark.parametrize("options", [{}, {"decimal": ","}])
def test_decimal_commas_are_read(tmp_path, delimiter, options):
    expected = read_tracks(write_csv(tmp_path / "points.csv", ROWS))
    assert "The commas in numbers are decimal signs." not in expected.notes
    path = write_csv(tmp_path / "commas.csv", [[row[0], *map(comma, row[1:])] for row in ROWS], delimiter=delimiter)
    read = read_tracks(path, **options)
    np.testing.assert_array_equal(read.position, expected.position)
    np.testing.assert_array_equal(read.time, expected.time)
    assert "The commas in numbers are decimal signs." in read.notes


def test_ids_and_timestamps_keep_their_signs(tmp_path):
    rows = [[f"{row[0]},5", f"2024-05-01T12:00:{row[1]:06.3f}", *map(comma, row[2:])] for row in ROWS]
    read = read_tracks(write_csv(tmp_path / "tracks.csv", rows, delimiter=";"))
    assert (read.ids[0], read.duration) == ("a,5", 9.5)
    rows = [[row[0], row[1].replace(".", ","), *row[2:]] for row in rows]
    assert read_tracks(write_csv(tmp_path / "commas.csv", rows, delimiter=";")).duration == 9.5


def test_numbers_whose_commas_may_separate_thousands_need_the_option(run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # messages shorten long paths
    rows = [[row[0], round(2 * row[1]), "1,512", f"{20 + k},125"] for k, row in enumerate(ROWS)]
    path = write_csv("tracks.csv", rows, delimiter=";")
    place = f"got '1,512' in row 2 of column 'x' in '{path}'"
    assert refusal(path) == f"x must be a number in every row, {place} (decimal=',' reads decimal commas)."
    assert run("detect", path)[2].endswith(f"{place} (--decimal , reads decimal commas).\n")
    assert np.ptp((read := read_tracks(path, decimal=",")).position[:, 1]) == pytest.approx(59)
    assert read.samples == 60
    assert run("detect", path, "--decimal", ",", "--window", "10", "--detector", "lagged-correlation")[0] == 0
    rows[5][2] = "0,512"  # no number of thousands begins with 0
    assert read_tracks(write_csv(path, rows, delimiter=";")).samples == 60


@pytest.mark.parametrize(
    ("cells", "options", "expected"),
    [
        (["1,5", "2.5"], {}, "x must be a number in every row, got '1,5' in row 2"),
        (["1,5", "2.5"], {"decimal": ","}, "with a decimal comma in every row, as decimal=',' or"),
        (["1.234,5", "2,5"], {}, "x must be a number in every row, got '1.234,5' in row 2"),
        (["1,5", "2,5"], {"decimal": "."}, "got '1,5' in row 2"),
        (["1", "2"], {"decimal": ";"}, "decimal must be '.', ',' or None, got ';'."),
    ],
)
def test_mixed_signs_and_other_options_are_refused(tmp_path, cells, options, expected):
    rows = [["ab"[k], k, cell, 0] for k, cell in enumerate(cells)]
    assert expected in refusal(write_csv(tmp_path / "tracks.csv", rows, HEADER, delimiter=";"), **options)
