"""The base class of all configurations: frozen, typed and validated.

An invalid value raises :class:`ArgumentError`. Its message is one sentence with the argument, the value and what the
argument takes.
"""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, ValidationError, model_validator

__all__ = ["ArgumentError", "Config", "quote", "unknown_name"]

_LONGEST_VALUE = 80

_EXPECTED = {  # texts for pydantic's error types
    "int_type": "a whole number",
    "float_type": "a number",
    "bool_type": "true or false",
    "string_type": "a name",
    "tuple_type": "a list",
    "finite_number": "a finite number",
}


class ArgumentError(ValueError):
    """An argument is invalid; the message is one sentence with its name, its value and what it takes."""


def quote(value: object) -> str:
    """Format ``value`` for an error message: its ``repr`` on one line of at most 80 characters."""
    text = " ".join(repr(value).split())
    return text if len(text) <= _LONGEST_VALUE else text[: _LONGEST_VALUE - 1] + "…"


def unknown_name(argument: str, got: object, known: Iterable[str]) -> ArgumentError:
    """The error for a name that is not registered; it suggests the most similar known name."""
    names = sorted(known)
    near = get_close_matches(got, names, n=1) if isinstance(got, str) else []
    hint = f" (did you mean {near[0]!r}?)" if near else ""
    return ArgumentError(f"{argument} must be one of {', '.join(names)}, got {quote(got)}{hint}.")


def _to_python(value: Any) -> Any:
    """Convert NumPy scalars and arrays, and lists, to the plain Python values that strict types accept."""
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray):
        return tuple(value.tolist())
    if isinstance(value, list):
        return tuple(_to_python(item) for item in value)
    return value


def _to_sentence(error: ValidationError) -> str:
    """The first error that pydantic found, as one sentence."""
    first = error.errors()[0]
    name = str(first["loc"][0]) if first["loc"] else "configuration"
    if first["type"] == "value_error":  # raised by a validator of this project: its text is the sentence
        return str(first["ctx"]["error"])
    if first["type"] == "extra_forbidden":
        return f"{name} is not an argument of this configuration, got {quote(first['input'])}."
    takes = _EXPECTED.get(first["type"], first["msg"].removeprefix("Input should be ").rstrip("."))
    return f"{name} must be {takes}, got {quote(first['input'])}."


class Config(BaseModel):
    """A frozen, strictly typed configuration; an invalid value raises :class:`ArgumentError`."""

    model_config = ConfigDict(
        frozen=True, strict=True, extra="forbid", allow_inf_nan=False, arbitrary_types_allowed=True
    )

    def __init__(self, **values: Any) -> None:
        try:
            super().__init__(**values)
        except ValidationError as error:
            raise ArgumentError(_to_sentence(error)) from None

    @model_validator(mode="before")
    @classmethod
    def _plain_values(cls, values: Any) -> Any:
        if isinstance(values, dict):
            return {name: _to_python(value) for name, value in values.items()}
        return values
