"""What every configuration of this project has in common: frozen, typed, and checked in one place.

A value that is refused raises :class:`ArgumentError` with one sentence that names the argument, what it got and
what it takes.
"""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, ValidationError, model_validator

__all__ = ["ArgumentError", "Config", "quote", "unknown_name"]

_LONGEST_VALUE = 80

_TAKES = {  # pydantic's error types in the words of this project
    "int_type": "a whole number",
    "float_type": "a number",
    "bool_type": "true or false",
    "string_type": "a name",
    "tuple_type": "a list",
    "finite_number": "a finite number",
}


class ArgumentError(ValueError):
    """An argument was refused; the message is one sentence for the person who gave it."""


def quote(value: object) -> str:
    """``value`` as it stands in an error message: its ``repr``, shortened and on one line."""
    text = " ".join(repr(value).split())
    return text if len(text) <= _LONGEST_VALUE else text[: _LONGEST_VALUE - 1] + "…"


def unknown_name(argument: str, got: object, known: Iterable[str]) -> ArgumentError:
    """The error for a name that is in no registry, with the nearest known name as a hint."""
    names = sorted(known)
    near = get_close_matches(got, names, n=1) if isinstance(got, str) else []
    hint = f" (did you mean {near[0]!r}?)" if near else ""
    return ArgumentError(f"{argument} must be one of {', '.join(names)}, got {quote(got)}{hint}.")


def _as_python(value: Any) -> Any:
    """NumPy scalars and arrays, and lists, as the plain Python values that strict types accept."""
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray):
        return tuple(value.tolist())
    if isinstance(value, list):
        return tuple(_as_python(item) for item in value)
    return value


def _sentence(error: ValidationError) -> str:
    """The first thing that pydantic refused, as one sentence."""
    first = error.errors()[0]
    name = str(first["loc"][0]) if first["loc"] else "configuration"
    if first["type"] == "value_error":  # a validator of ours: its text is the sentence
        return str(first["ctx"]["error"])
    if first["type"] == "extra_forbidden":
        return f"{name} is not an argument of this configuration, got {quote(first['input'])}."
    takes = _TAKES.get(first["type"], first["msg"].removeprefix("Input should be ").rstrip("."))
    return f"{name} must be {takes}, got {quote(first['input'])}."


class Config(BaseModel):
    """A frozen, strictly typed configuration whose refusals are one sentence long."""

    model_config = ConfigDict(
        frozen=True, strict=True, extra="forbid", allow_inf_nan=False, arbitrary_types_allowed=True
    )

    def __init__(self, **values: Any) -> None:
        try:
            super().__init__(**values)
        except ValidationError as error:
            raise ArgumentError(_sentence(error)) from None

    @model_validator(mode="before")
    @classmethod
    def _plain_values(cls, values: Any) -> Any:
        if isinstance(values, dict):
            return {name: _as_python(value) for name, value in values.items()}
        return values
