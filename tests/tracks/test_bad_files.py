"""A file that can't be right is refused by both public functions: one sentence names the place, no file is written."""

import zipfile

import pytest
from track_files import rows_of, straight

from usnet_env import ArgumentError
from usnet_env.tracks import read_tracks

pyarrow = pytest.importorskip("pyarrow")
parquet = pytest.importorskip("pyarrow.parquet")
LINES = [",".join(map(str, row)) for row in rows_of(straight())]


def csv_of(*more, head="id,t,x,y", lines=LINES, encoding="utf-8"):
    """What writes a CSV of good rows, and then those of ``more``."""
    return "tracks.csv", lambda path: path.write_bytes("\n".join([head, *lines, *more, ""]).encode(encoding))


def parquet_of(name="tracks.parquet", cut=0, **columns):
    """What writes a Parquet file with some columns replaced (``None``: left out), without its last ``cut`` bytes."""
    values = {name: [row[k] for row in rows_of(straight())] for k, name in enumerate(("id", "t", "x", "y"))} | columns

    def write(path):
        parquet.write_table(pyarrow.table({name: each for name, each in values.items() if each is not None}), path)
        path.write_bytes(path.read_bytes()[: path.stat().st_size - cut])

    return name, write


def write_marked_twice(path):
    """A Parquet file with two columns of one name, which marks outliers."""
    columns = [list(column) for column in zip(*rows_of(straight()), strict=True)]
    marks = [["false"] * len(columns[0])] * 2
    names = ["id", "t", "x", "y", *["manually_marked_outlier"] * 2]
    parquet.write_table(pyarrow.Table.from_arrays([pyarrow.array(each) for each in columns + marks], names), path)


def write_bomb(path):
    """A zip of a megabyte that expands to 400 MiB."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive, archive.open("tracks.csv", "w") as file:
        file.write(b"id,t,x,y\n")
        for _ in range(400):
            file.write(b"a,0,1,2\n" * 2**17)


BAD = {
    "a missing column": (csv_of(head="id,t,x,u"), "for y, such as"),
    "a missing column of Parquet": (parquet_of(y=None), "for y; no name among"),
    "a column twice": (csv_of(head="id,t,x,x"), "for y; no name among"),
    "a column of coordinates twice": (csv_of(head="id,t,x,x,y", lines=["a,0,1,1,2"]), "2 columns 'x' for x"),
    "a column of marks twice": (
        csv_of(head="id,t,x,y,visible,visible,tag-local-identifier", lines=[f"{line},true,false,1" for line in LINES]),
        "2 columns 'visible' for visible",
    ),
    "a column of marks twice in Parquet": (
        ("tracks.parquet", write_marked_twice),
        "2 columns 'manually_marked_outlier' for manually_marked_outlier",
    ),
    "NaN": (csv_of("a,99,nan,1"), "row 62 of column 'x'"),
    "no value in Parquet": (parquet_of(x=[None] * 60), "row 2 of column 'x'"),
    "one id": (csv_of(lines=[line for line in LINES if line[0] == "a"]), "with 'a' in column 'id'"),
    "duplicate times": (csv_of("a,0.5,77,8"), "in rows 5 and 62"),
    "text in numbers": (csv_of("a,99,north,1"), "'north' in row 62 of column 'x'"),
    "text in numbers of Parquet": (parquet_of(x=["north"] * 60), "'north' in row 2 of column 'x'"),
    "truth values in numbers": (parquet_of(x=[True] * 60), "True in row 2 of column 'x'"),
    "an empty file": (("tracks.csv", lambda path: path.touch()), "which is empty"),
    "an empty Parquet file": (("tracks.parquet", lambda path: path.touch()), "which is empty"),
    "only names": (csv_of(lines=[]), "without rows"),
    "truncated Parquet": (parquet_of(cut=30), "intact Parquet file"),
    "latin-1": (csv_of("möwe,0,1,2", encoding="latin-1"), "row 62 holds the byte 0xF6 at place 2"),
    "UTF-16": (csv_of(encoding="utf-16"), "in UTF-16"),
    "a zip bomb": (("tracks.zip", write_bomb), "exceeds 268435456 bytes"),
}


@pytest.mark.parametrize("what", BAD)
def test_a_bad_file_is_refused_in_one_sentence_and_nothing_is_written(run, tmp_path, monkeypatch, what):
    (name, write), expected = BAD[what]
    monkeypatch.chdir(tmp_path)
    write(tmp_path / name)
    status, printed, err = run("detect", name, "--detector", "lagged-correlation", "--out", "found", "--record")
    assert (status, printed) == (2, "")
    with pytest.raises(ArgumentError) as caught:
        read_tracks(name)
    assert expected in str(caught.value)
    assert err.endswith(f"{str(caught.value)[-25:]}\n")  # the names of arguments and options differ
    assert err.endswith(".\n")
    assert [path.name for path in tmp_path.iterdir()] == [name]
