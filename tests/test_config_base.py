"""The base of all configurations; named apart from tests/swarm/test_config.py, as module names must differ."""

from pathlib import Path
from typing import Annotated

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import Field, field_validator

from usnet_env.config import (
    ArgumentError,
    Config,
    missing_extra,
    named_values,
    optional_seed,
    quote,
    real_number,
    unknown_name,
    whole_number,
)

TAKES = "it takes count, rate, flag, name, sizes."


class Sample(Config):
    count: Annotated[int, Field(ge=1)] = 1
    rate: Annotated[float, Field(ge=0, le=1)] = 0.0
    flag: bool = False
    name: str = "a"
    sizes: tuple[int, ...] | None = None

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
        ({"count": "3"}, "count must be a whole number, got '3'."),
        ({"count": None}, "count must be a whole number, got None."),
        ({"rate": np.nan}, "rate must be a finite number, got nan."),
        ({"rate": float("inf")}, "rate must be a finite number, got inf."),
        ({"rate": 2}, "rate must be less than or equal to 1, got 2."),
        ({"rate": "fast"}, "rate must be a valid number, got 'fast'."),
        ({"flag": 1}, "flag must be a valid boolean, got 1."),
        ({"name": 7}, "name must be a name, got 7."),
        ({"name": "long one"}, "name must be short, got 'long one'."),
        ({"sizes": "7,5"}, "sizes must be a list, such as [7, 5], got '7,5'."),
        ({"sizes": np.array(6)}, "sizes must be a list, such as [7, 5], got 6."),
        (
            {"rates": 1},
            f"rates is not an argument of Sample (did you mean 'rate'?); {TAKES}",
        ),
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
    assert sample.model_dump() == {"count": 3, "rate": 0.5, "flag": True, "name": "a", "sizes": (1, 2)}
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
    assert str(unknown_name("follow", "f11", ["f2", "f1"])) == (
        "follow must be one of f1, f2, got 'f11' (did you mean 'f1'?)."
    )
    assert str(unknown_name("metric", "j", ["J", "rounds"])).endswith("got 'j' (did you mean 'J'?).")
    assert str(unknown_name("follow", None, ["f1"])) == "follow must be one of f1, got None."


@pytest.mark.parametrize("value", [3, np.int8(3), np.array(3)])
def test_numbers_of_numpy_are_numbers(value):
    assert type(whole_number("count", value, 1, 3)) is int
    assert type(real_number("rate", value, 0, 3)) is float
    assert optional_seed("seed", value) == 3


@pytest.mark.parametrize("value", [True, 0, 5, "3", 1.5, None, [3], np.nan])
def test_what_is_no_number_in_the_limits_is_refused(value):
    with pytest.raises(ArgumentError, match=r"^count must be a whole number from 1 to 4, got "):
        whole_number("count", value, 1, 4)
    if value != 1.5:
        with pytest.raises(ArgumentError, match=r"^rate must be a number from 1 to 4, got "):
            real_number("rate", value, 1, 4)


def test_texts_and_named_values_are_what_they_say():
    assert (named_values("extras", None), named_values("extras", {"a": 1})) == ({}, {"a": 1})
    for check, value in ((named_values, [1]), (named_values, {1: 2})):
        with pytest.raises(ArgumentError, match=r"^it must be "):
            check("it", value)


def test_the_package_of_an_extra_is_named_with_its_command():
    error = ModuleNotFoundError("No module named 'torch.nn'", name="torch.nn")
    assert str(missing_extra("it", error)) == "it needs torch; `pip install 'usnet[torch]'` installs it."
    assert missing_extra("it", ModuleNotFoundError("No module named 'torchy'", name="torchy")) is None
    assert missing_extra("it", OSError("torch")) is None
