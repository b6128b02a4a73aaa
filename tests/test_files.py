"""Files are written whole or not at all, and a folder that can't be written is refused before the work."""

from pathlib import Path

import pytest

from usnet_env import ArgumentError
from usnet_env.files import as_path, atomic_write, replace_files, reserve_folder, write_text


def test_a_file_is_replaced_at_the_end_only(tmp_path):
    path = tmp_path / "new" / "a.txt"
    write_text(path, "old\n")
    with atomic_write(path) as aside:
        aside.write_text("half")
        assert path.read_text() == "old\n"
        aside.write_text("new")
    assert path.read_text() == "new"
    with pytest.raises(UnicodeEncodeError), atomic_write(path) as aside:
        aside.write_text("\ud800", encoding="utf-8")
    assert path.read_text() == "new"
    assert list(path.parent.iterdir()) == [path]


def test_files_are_replaced_together_and_optional_ones_go(tmp_path):
    for name in ("a", "b", "mine"):
        write_text(tmp_path / name, "old")
    with pytest.raises(UnicodeEncodeError), replace_files(tmp_path, ["b", "c"]) as aside:
        write_text(aside / "a", "\ud800")
    assert {file.name: file.read_text() for file in tmp_path.iterdir()} == dict.fromkeys(("a", "b", "mine"), "old")
    with replace_files(tmp_path, ["b", "c"]) as aside:
        write_text(aside / "a", "new")
    assert {file.name: file.read_text() for file in tmp_path.iterdir()} == {"a": "new", "mine": "old"}


def test_what_cannot_be_written_is_one_sentence(tmp_path):
    for path in (tmp_path, "/dev/null/x", "x" * 300):
        with pytest.raises(ArgumentError, match=r"^path must be a file that can be written, got .*\.$"):
            write_text(path, "text")


def test_a_folder_is_made_and_tried(tmp_path):
    assert reserve_folder(tmp_path / "a" / "b") == tmp_path / "a" / "b"
    assert list((tmp_path / "a" / "b").iterdir()) == []
    write_text(tmp_path / "file", "")
    for folder in (Path("/dev/null/x"), tmp_path / "file", Path("/proc/nowhere")):
        with pytest.raises(ArgumentError, match=r"^out must be a folder that can be written, got .*\.$"):
            reserve_folder(folder)


@pytest.mark.parametrize("value", [None, 3, "", b"bytes", "nul\0", ["a"]])
def test_what_is_no_path_is_refused(value):
    assert as_path("out", "a/b") == as_path("out", Path("a/b")) == Path("a/b")
    with pytest.raises(ArgumentError, match=r"^out must be a path, got "):
        as_path("out", value)
