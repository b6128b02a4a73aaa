"""Checked arguments, and files that are written whole or not at all."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import Field, field_validator

from usnet_env.config import ArgumentError, Config, Positive, missing_extra, quote, unknown_name
from usnet_env.files import as_path, atomic_write, replace_files, reserve_folder, write_text

TAKES = "it takes count, rate, flag, name, sizes, span."


class Sample(Config):
    count: Annotated[int, Field(ge=1)] = 1
    rate: Annotated[float, Field(ge=0, le=1)] = 0.0
    flag: bool = False
    name: str = "a"
    sizes: tuple[int, ...] | None = None
    span: Annotated[tuple[int, ...], Field(min_length=1, max_length=2)] | Mapping[str, Positive] = (1,)

    @field_validator("name")
    @classmethod
    def _short(cls, name: str) -> str:
        if len(name) > 3:
            raise ArgumentError(f"name must be short, got {quote(name)}.")
        return name


@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        ({"count": 0}, "count must be greater than or equal to 1, got 0."),
        ({"count": 1.5}, "count must be a whole number, got 1.5."),
        ({"count": True}, "count must be a whole number, got True."),
        ({"rate": np.nan}, "rate must be a finite number, got nan."),
        ({"rate": float("inf")}, "rate must be a finite number, got inf."),
        ({"rate": 2}, "rate must be less than or equal to 1, got 2."),
        ({"rate": "fast"}, "rate must be a valid number, got 'fast'."),
        ({"flag": 1}, "flag must be a valid boolean, got 1."),
        ({"name": 7}, "name must be a name, got 7."),
        ({"name": "long one"}, "name must be short, got 'long one'."),
        ({"sizes": "7,5"}, "sizes must be a list, such as [7, 5], got '7,5'."),
        ({"sizes": np.array(6)}, "sizes must be a list, such as [7, 5], got 6."),
        ({"span": ()}, "span must be a list of length 1 or more, got ()."),
        ({"span": (1, 2, 3)}, "span must be a list of length 2 or less, got (1, 2, 3)."),
        ({"span": (1, "b")}, "span[1] must be a whole number, got 'b'."),
        ({"span": {"b": -1}}, "span['b'] must be greater than 0, got -1."),
        ({"rates": 1}, f"rates is not an argument of Sample (did you mean 'rate'?); {TAKES}"),
        ({"other": 3}, f"other is not an argument of Sample; {TAKES}"),
    ],
)
def test_each_refusal_is_one_sentence(values, sentence):
    with pytest.raises(ArgumentError) as caught:
        Sample(**values)
    assert str(caught.value) == sentence
    assert caught.value.__cause__ is None


def test_an_argument_without_a_default_must_be_given():
    class Needed(Config):
        path: str

    with pytest.raises(ArgumentError, match=r"^path must be given\.$"):
        Needed()
    assert Needed(path=Path("a") / "b").path == str(Path("a") / "b")


def test_numpy_values_and_lists_are_taken_as_plain_python():
    sample = Sample(count=np.int64(3), rate=np.float32(0.5), flag=np.bool_(True), sizes=np.array([1, 2]))
    assert sample.model_dump() == {"count": 3, "rate": 0.5, "flag": True, "name": "a", "sizes": (1, 2), "span": (1,)}
    assert type(sample.count) is int
    assert Sample(sizes=[np.int8(1), 2]).sizes == (1, 2)
    assert Sample(count=np.array(6), rate=np.array(0.5)) == Sample(count=6, rate=0.5)


def test_an_argument_that_is_declared_as_a_list_or_an_array_keeps_its_type():
    class Declared(Config):
        lags: list[int]
        bounds: list[float] | None = None
        weights: np.ndarray | None = None

    weights = np.ones((2, 2))
    declared = Declared(lags=[1, 2], bounds=[0.5], weights=weights)
    assert (declared.lags, declared.bounds) == ([1, 2], [0.5])
    assert declared.weights is weights
    with pytest.raises(ArgumentError, match=r"^lags must be a list.*, got 3\.$"):
        Declared(lags=3)


def test_a_config_is_frozen_compares_by_value_and_may_hold_others():
    class Outer(Config):
        samples: tuple[Sample, ...]

    sample = Sample(count=2)
    assert Outer(samples=[sample]).samples == (sample,)
    with pytest.raises(ArgumentError, match=r"^samples must be .*, got 3\.$"):
        Outer(samples=[3])
    with pytest.raises(ValueError, match="frozen"):
        sample.count = 3
    assert sample == Sample(count=2) != Sample(count=3)
    assert hash(sample) == hash(Sample(count=2))


def _bomb():
    """Ten levels of lists that hold the same list ten times: ten thousand million items."""
    value = ["x"] * 10
    for _ in range(9):
        value = [value] * 10
    return value


@pytest.mark.parametrize("value", [_bomb(), "x" * 10**6, dict.fromkeys(range(9), "y" * 10**6)], ids=range(3))
def test_quote_looks_at_the_beginning_of_a_long_value_only(value):
    assert 1 < len(quote(value)) <= 80
    with pytest.raises(ArgumentError, match="name must be"):
        Sample(name=value)


@given(st.text())
def test_quote_is_one_line_and_short(text):
    assert len(quote(text)) <= 80
    assert "\n" not in quote(text)
    assert quote([1, "a"]) == "[1, 'a']"


def test_unknown_name_lists_the_known_and_hints_at_the_nearest():
    sentence = "metric must be one of J, rounds, got 'ROUND' (did you mean 'rounds'?)."
    assert str(unknown_name("metric", "ROUND", ["rounds", "J"])) == sentence
    assert str(unknown_name("follow", None, ["f1"])) == "follow must be one of f1, got None."


def test_the_package_of_an_extra_is_named_with_its_command():
    error = ModuleNotFoundError("No module named 'torch.nn'", name="torch.nn")
    assert str(missing_extra("it", error)) == "it needs torch; `pip install 'usnet[torch]'` installs it."
    assert missing_extra("it", ModuleNotFoundError("No module named 'torchy'", name="torchy")) is None
    assert missing_extra("it", OSError("torch")) is None


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
    assert (path.read_text(), list(path.parent.iterdir())) == ("new", [path])


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
