"""Rows that are named in messages, archives, and files that are small on the disk and large in memory."""

import gzip
import time
import zipfile

import numpy as np
import pytest
from track_files import HEADER, rows_of, straight, write_csv

from usnet_env import ArgumentError
from usnet_env.tracks import Tracks, read_tracks

ROWS = rows_of(straight())


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    """Messages cut long paths, so files are named from their folder."""
    monkeypatch.chdir(tmp_path)


def refusal(*paths, **options):
    with pytest.raises(ArgumentError) as caught:
        read_tracks([path.name for path in paths], **options)
    return str(caught.value)


def test_rows_after_a_skipped_row_keep_their_numbers(tmp_path):
    rows = [*ROWS[:3], ["a", 2.0, "", 1], *ROWS[3:], [*ROWS[-1][:2], 9, 9]]
    path = write_csv(tmp_path / "tracks.csv", rows)
    assert refusal(path, missing="skip").endswith("in rows 62 and 63 of 'tracks.csv'.")


def test_rows_of_several_files_are_named_with_their_file(tmp_path):
    one, two = write_csv(tmp_path / "1.csv", ROWS), write_csv(tmp_path / "2.csv", [["d", 0, 1, 2], ["a", 1.0, 9, 9]])
    assert refusal(one, two).endswith("in row 8 of '1.csv' and row 3 of '2.csv'.")
    assert refusal(two, one).endswith("in row 3 of '2.csv' and row 8 of '1.csv'.")


@pytest.mark.parametrize("gap", ["\n\n\n", '"a\n\n",9,1,1\n'])
def test_the_row_is_the_line_in_which_it_begins(tmp_path, gap):
    path = tmp_path / "tracks.csv"
    path.write_text(f"id,t,x,y\na,0,1,2\n{gap}b,0,1,east\n")
    assert f"row {3 + gap.count(chr(10))} of column 'y'" in refusal(path)
    path.write_text(f"id,t,x,y\na,0,1,2\n{gap}b,0,1\n")
    assert refusal(path).endswith(f"with 3 in row {3 + gap.count(chr(10))}.")


def test_instants_points_and_samples_are_named_as_such(tmp_path):
    times = np.arange(20.0)
    times[7] = 6
    np.savez(tmp_path / "tracks.npz", position=straight(), t=times)
    assert refusal(tmp_path / "tracks.npz").endswith("in instants 6 and 7 of 'tracks.npz'.")
    times[7] = np.nan
    np.savez(tmp_path / "tracks.npz", position=straight(), t=times)
    assert "in instant 7 of column 't'" in refusal(tmp_path / "tracks.npz")
    point = '<trkpt lat="50" lon="{}"><time>2024-05-01T00:00:00Z</time></trkpt>'
    (tmp_path / "a.gpx").write_text(f"<gpx><trk><trkseg>{point.format(1)}{point.format(2)}</trkseg></trk><trk/></gpx>")
    (tmp_path / "b.gpx").write_text(f"<gpx><trk><trkseg>{point.format(3)}</trkseg></trk></gpx>")
    assert "in points 1 and 2 of" in refusal(tmp_path / "a.gpx", tmp_path / "b.gpx")
    with pytest.raises(ArgumentError, match=r"in samples 0 and 2\.$"):
        Tracks.from_samples(["a", "b", "a"], [0, 0, 0], [[0, 0], [1, 1], [2, 2]])


def test_a_zip_that_a_mac_has_made_and_gpx_in_archives(tmp_path):
    path = write_csv(tmp_path / "tracks.csv", ROWS)
    with zipfile.ZipFile(tmp_path / "mac.zip", "w") as archive:
        archive.write(path, "tracks.csv")
        archive.writestr("__MACOSX/._tracks.csv", b"\0\5\x16\7")
    assert read_tracks(tmp_path / "mac.zip").samples == 60
    point = '<trkpt lat="50" lon="10"><time>2024-05-01T00:00:00Z</time></trkpt>'
    text = "".join(f"<trk><name>{name}</name><trkseg>{point}</trkseg></trk>" for name in "ab")
    with gzip.open(tmp_path / "tracks.gpx.gz", "wt") as file:
        file.write(f"<gpx>{text}</gpx>")
    with zipfile.ZipFile(tmp_path / "gpx.zip", "w") as archive:
        archive.writestr("tracks.gpx", f"<gpx>{text}</gpx>")
    for name in ("tracks.gpx.gz", "gpx.zip"):
        assert read_tracks(tmp_path / name).ids == ("a", "b")
    (tmp_path / "cut.zip").write_bytes((tmp_path / "gpx.zip").read_bytes()[:40])
    assert refusal(tmp_path / "cut.zip").startswith("path must be an intact file")


@pytest.mark.parametrize("kind", ["string", "large_string", "binary"])
def test_a_long_text_in_every_row_of_parquet_is_held_once(tmp_path, kind):
    pyarrow = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    rows = 40_000
    long = pyarrow.DictionaryArray.from_arrays(np.arange(rows) % 2, pyarrow.array(["y" * 12_000, "z" * 12_000]))
    table = pyarrow.table({"id": long, **{name: np.arange(float(rows)) for name in HEADER[1:]}})
    parquet.write_table(table, tmp_path / "whole.parquet")
    plain = pyarrow.table({"id": pyarrow.array(["y" * 12_000, "z" * 12_000] * 500, kind)}).append_column(
        "t", pyarrow.array(np.arange(1000.0))
    )
    for name in "xy":
        plain = plain.append_column(name, plain["t"])
    parquet.write_table(plain, tmp_path / "plain.parquet")
    assert read_tracks(tmp_path / "plain.parquet").samples == 1000
    assert read_tracks(tmp_path / "whole.parquet").samples == rows
    assert pyarrow.default_memory_pool().max_memory() < 2**28


def test_texts_that_expand_to_too_many_bytes_are_refused(tmp_path):
    pyarrow = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    ids = [f"{'y' * 10_000}{k}" for k in range(300)]
    table = pyarrow.table({"id": ids, **{name: np.arange(300.0) for name in HEADER[1:]}})
    parquet.write_table(table, tmp_path / "tracks.parquet", compression="zstd")
    assert (tmp_path / "tracks.parquet").stat().st_size < 10**5
    assert refusal(tmp_path / "tracks.parquet", max_bytes=10**6).startswith("max_bytes must be at least the 3")


def test_ids_beside_positions_take_no_longer_than_without(tmp_path):
    position = np.random.default_rng(0).normal(size=(500, 400, 2)).cumsum(axis=0)
    np.savez(tmp_path / "plain.npz", position=position)
    np.savez(tmp_path / "named.npz", position=position, id=np.array([f"id-{k}" for k in range(400)]))

    def seconds(name):
        start = time.process_time()
        read_tracks(tmp_path / name)
        return time.process_time() - start

    assert seconds("named.npz") < 5 * seconds("plain.npz") + 0.2
