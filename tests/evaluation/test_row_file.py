"""The file of rows: constant cost, torn lines, full disks, two writers, vanished files, files of other programs."""

from __future__ import annotations

import os
import resource
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from detectors.studies import metric_learning, purity, rounds, table2
from usnet_env import ArgumentError
from usnet_env.evaluation.store import COLUMNS, RowFile
from usnet_env.evaluation.table import RowTable, columns_of, read_table

PAIRS = {"name": "str", "number": "int", "value": "float", "right": "bool", "share": "float | None"}
RESULTS = Path(__file__).parents[2] / "benchmarks" / "results"


def row_of(number):
    return {
        "name": f"detector {number % 3}",
        "number": number,
        "value": number / 7,
        "right": number % 2 == 0,
        "share": None if number % 5 == 0 else 1 / (number + 1),
    }


ROWS = [row_of(number) for number in range(20)]


def count_calls(action):
    """Calls of functions, those written in C included, that an action makes."""
    calls = 0

    def count(frame, event, argument):
        nonlocal calls
        calls += event in ("call", "c_call")

    before = sys.getprofile()
    sys.setprofile(count)
    try:
        action()
    finally:
        sys.setprofile(before)
    return calls


def test_a_row_costs_the_same_whatever_the_number_of_rows(tmp_path):
    path, costs = tmp_path / "rows.csv", []
    with RowFile(path, PAIRS) as file:
        file.append([row_of(1000)])
        inode = path.stat().st_ino
        for filled in (10, 10_000):
            file.append(row_of(1000) for _ in range(filled))
            size = path.stat().st_size
            calls = count_calls(lambda: file.append([row_of(1000)]))
            costs.append((calls, path.stat().st_size - size))
        assert path.stat().st_ino == inode  # the file was never replaced
    assert costs[0] == costs[1]
    assert costs[0][1] == len(RowTable(PAIRS, [row_of(1000)]).format_csv())


def test_a_line_that_was_torn_anywhere_is_dropped_and_the_file_goes_on(tmp_path):
    path = tmp_path / "rows.csv"
    with RowFile(path, PAIRS) as file:
        file.append(ROWS[:2])
    whole = path.read_bytes()
    last = whole[: whole.rfind(b"\n", 0, -1) + 1]
    for cut in range(len(last) + 1, len(whole)):
        path.write_bytes(whole[:cut])
        assert list(read_table(path, PAIRS)) == ROWS[:1]
        with RowFile(path, PAIRS) as file:
            assert list(file.table) == ROWS[:1]
            file.append(ROWS[1:2])
        assert path.read_bytes() == whole


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="a limit of the size of files")
def test_a_full_disk_is_one_sentence_and_leaves_whole_rows(tmp_path):
    path = tmp_path / "rows.csv"
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    with RowFile(path, PAIRS) as file:
        file.append(ROWS[:3])
        size = path.stat().st_size
        resource.setrlimit(resource.RLIMIT_FSIZE, (size + 5, before[1]))
        try:
            with pytest.raises(
                ArgumentError, match=r"^out must be a folder that can be written, got .*: File too large"
            ):
                file.append(ROWS[3:5])
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)
        assert path.stat().st_size == size
        assert list(file.table) == ROWS[:3]
        file.append(ROWS[3:5])
    assert list(read_table(path, PAIRS)) == ROWS[:5]


def test_a_second_writer_is_refused_and_the_first_goes_on(tmp_path):
    path = tmp_path / "rows.csv"
    with RowFile(path, PAIRS) as file:
        with pytest.raises(ArgumentError, match=rf"no other run uses, .* which process {os.getpid()} uses"):
            RowFile(path, PAIRS)
        file.append(ROWS)
    assert list(read_table(path, PAIRS)) == ROWS
    assert [each.name for each in tmp_path.iterdir()] == ["rows.csv"]


@pytest.mark.parametrize("how", ["removed", "replaced", "changed"])
def test_a_file_that_is_removed_or_changed_by_others_is_an_error(tmp_path, how):
    path = tmp_path / "rows.csv"
    with RowFile(path, PAIRS) as file:
        file.append(ROWS[:1])
        text = path.read_text()
        if how == "changed":
            with path.open("a") as other:
                other.write("mine\n")
        else:
            path.rename(tmp_path / "elsewhere.csv")
        if how == "replaced":
            path.write_text(text)
        with pytest.raises(ArgumentError, match=r"^out must stay as it is .* which was removed or changed\."):
            file.append(ROWS[1:2])
        assert list(file.table) == ROWS[:1]


def test_what_a_killed_program_left_aside_is_removed(tmp_path):
    (tmp_path / f".rows.csv.{'0a' * 16}").write_text("half")
    (tmp_path / ".rows.csv.mine").write_text("mine")
    with RowFile(tmp_path / "rows.csv", PAIRS) as file:
        file.append(ROWS)
    assert {each.name for each in tmp_path.iterdir()} == {"rows.csv", ".rows.csv.mine"}


def test_rows_can_be_sorted_at_the_end_and_the_file_still_grows(tmp_path):
    path = tmp_path / "rows.csv"
    with RowFile(path, PAIRS) as file:
        file.append(reversed(ROWS[:5]))
        file.sort(lambda table: np.argsort(table.column("number")))
        file.append(ROWS[5:])
    assert list(read_table(path, PAIRS)) == ROWS


def test_a_file_with_other_columns_beside_is_read_and_written_again_with_these(tmp_path):
    path = tmp_path / "rows.csv"
    path.write_text("number,more,value\n3,x,1.5\n")
    with RowFile(path, {"value": "float", "number": "int"}) as file:
        file.append([{"value": 2.0, "number": 4}])
    assert path.read_text() == "value,number\n1.5,3\n2.0,4\n"


def test_rows_are_mappings_of_plain_values():
    table = RowTable(PAIRS, ROWS)
    assert table == ROWS
    assert table[2:5] == ROWS[2:5]
    assert table[-1] == ROWS[-1]
    assert table != ROWS[:-1]
    assert {type(value) for row in table for value in row.values()} == {str, int, float, bool, type(None)}
    assert table.take([3, 1]) == [ROWS[3], ROWS[1]]
    assert list(table.column("name")[:3]) == ["detector 0", "detector 1", "detector 2"]
    with pytest.raises(KeyError):
        table.append({"name": "half a row"})
    assert table == ROWS


@given(
    st.lists(
        st.fixed_dictionaries(
            {
                "name": st.text(st.characters(codec="utf-8", exclude_categories=["Cc", "Cs"]), max_size=8),
                "number": st.integers(-(2**63), 2**63 - 1),
                "value": st.floats(allow_nan=False),
                "right": st.booleans(),
                "share": st.none() | st.floats(allow_nan=False),
            }
        )
    )
)
def test_any_rows_survive_the_file(tmp_path_factory, rows):
    path = tmp_path_factory.mktemp("rows") / "rows.csv"
    with RowFile(path, PAIRS) as file:
        file.append(rows)
    assert read_table(path, PAIRS) == rows


@pytest.mark.parametrize(
    ("folder", "record"),
    [
        ("table2", table2.Row),
        ("purity", purity.Row),
        ("rounds", rounds.Row),
        ("metric_learning", metric_learning.Row),
    ],
)
def test_committed_rows_are_written_again_byte_for_byte(folder, record):
    for path in (RESULTS / folder).glob("*.csv"):
        table = read_table(path, columns_of(record))
        text = ",".join(table.columns) + "\n" + table.format_csv(digits=4)
        assert text.encode() == path.read_bytes(), path.name


def test_a_number_takes_eight_bytes_and_a_text_is_stored_once():
    row = dict.fromkeys(COLUMNS, 1)
    table = RowTable(COLUMNS, (row | {"detector": "".join(("ran", "dom"))} for _ in range(2_000)))
    assert all(values.itemsize == 8 for name, values in table._values.items() if COLUMNS[name] != "str")
    assert len({id(text) for text in table.column("detector")}) == 1
    assert len(table) == 2_000


def test_files_that_a_killed_process_had_begun_are_removed(tmp_path):
    begun = [tmp_path / f".rows.{kind}.{'0f' * 16}" for kind in ("csv", "png")]
    others = [tmp_path / f".other.csv.{'0f' * 16}", tmp_path / ".rows.csv.bak"]
    for path in (*begun, *others):
        path.write_text("half")
    RowFile(tmp_path / "rows.csv", COLUMNS).close()
    assert [path for path in (*begun, *others) if path.exists()] == others
