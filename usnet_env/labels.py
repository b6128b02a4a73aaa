"""Labels of detectors, such as ``lagged-regression(clusters=5)``: a name and arguments as Python literals."""

from __future__ import annotations

import ast
import warnings
from collections.abc import Mapping
from hashlib import sha256
from types import FunctionType
from typing import Any

from usnet_env.config import ArgumentError, quote


def format_label(name: str, arguments: Mapping[str, Any]) -> str:
    """Format a name and arguments; without arguments, the name alone."""
    listed = ", ".join(f"{key}={_format_value(arguments[key])}" for key in sorted(arguments))
    return f"{name}({listed})" if listed else name


def _format_value(value: Any) -> str:
    """Format a value for a label, so that different values have different labels.

    A literal is shown in full: it may be typed again. A function is shown by its name, because its address differs from
    run to run. Any other value is shown in at most 80 characters, followed by a hash if it was cut.
    """
    if isinstance(value, FunctionType):
        return str(value.__qualname__)
    if _is_literal(value):
        return repr(value)
    short = quote(value)
    if not short.endswith("…"):
        return short
    return f"{short}#{sha256(repr(value).encode('utf-8', 'backslashreplace')).hexdigest()[:8]}"


def _is_literal(value: Any) -> bool:
    """Whether ``repr`` gives a literal that Python reads as the same value."""
    if isinstance(value, list | tuple | set):
        return all(map(_is_literal, value))
    if isinstance(value, dict):
        return all(map(_is_literal, [*value.keys(), *value.values()]))
    return value is None or type(value) in (bool, int, float, complex, str, bytes)


def parse_label(text: Any, more: Mapping[str, Any]) -> tuple[str, dict[str, Any]]:
    """Parse ``name(key=literal, ...)`` into the name and its arguments."""
    if not isinstance(text, str) or not text.strip():
        raise ArgumentError(f"detector must be a name, got {quote(text)}.")
    name, bracket, inner = text.strip().partition("(")
    arguments = _parse_literals(text, inner) if bracket else {}
    for argument in more:
        if argument in arguments:
            raise ArgumentError(f"{argument} must be given once, got it in {quote(text)} and as a further argument.")
    return name.strip(), {**arguments, **more}


def _parse_literals(text: str, inner: str) -> dict[str, Any]:
    """Parse the arguments in ``inner``, the part of ``text`` after the opening bracket."""
    message = f"detector must be written name(argument=value, ...) with Python literals as values, got {quote(text)}."
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", SyntaxWarning)  # suspicious syntax is refused below
            call = ast.parse(f"name({inner}", mode="eval").body
        if not isinstance(call, ast.Call) or not isinstance(call.func, ast.Name) or call.args:
            raise ArgumentError(message)
        arguments: dict[str, Any] = {}
        for keyword in call.keywords:
            if keyword.arg is None or keyword.arg in arguments:
                raise ArgumentError(message)
            arguments[keyword.arg] = ast.literal_eval(keyword.value)
    except (SyntaxError, ValueError, TypeError, MemoryError, RecursionError):
        raise ArgumentError(message) from None
    return arguments
