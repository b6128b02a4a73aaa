"""The base class of all configurations: frozen, typed and validated.

An invalid value raises :class:`ArgumentError`. Its message is one sentence with the argument, the value and what the
argument takes.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection, Iterable, Mapping
from difflib import get_close_matches
from functools import update_wrapper
from inspect import Parameter, Signature
from pathlib import PurePath
from types import MappingProxyType, UnionType
from typing import Any, ClassVar, Concatenate, ParamSpec, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np
from pydantic import BaseModel, ConfigDict, ValidationError, model_validator
from pydantic.fields import FieldInfo

_LONGEST_VALUE = 80

P = ParamSpec("P")
OwnerT = TypeVar("OwnerT")
ConfigT = TypeVar("ConfigT", bound="Config")
ClassT = TypeVar("ClassT", bound=type)

_EXPECTED = {  # texts for pydantic's error types
    "int_type": "a whole number",
    "float_type": "a number",
    "bool_type": "true or false",
    "string_type": "a name",
    "tuple_type": "a list",
    "list_type": "a list",
    "finite_number": "a finite number",
    "missing": "longer",
    "too_long": "shorter",
}


class ArgumentError(ValueError):
    """An argument is invalid; the message is one sentence with its name, its value and what it takes."""


class MissingExtraError(ImportError):
    """An optional package is not installed; the message gives the command that installs it."""


def format_count(number: int, noun: str) -> str:
    """Format a number with its noun: ``1 head``, ``2 heads``."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def format_number(value: float, digits: int = 6) -> str:
    """Format a number with some significant digits, and from 1 to 10**12 without an exponent: ``880``, ``0.5``."""
    return f"{float(f'{value:.{digits}g}'):.12g}"


def quote(value: object) -> str:
    """Format ``value`` for an error message: its ``repr`` on one line of at most 80 characters.

    A value without a ``repr`` is described instead: an object whose ``repr`` raises, or an integer that Python does not
    write because it has too many digits.
    """
    try:
        # A long text is cut first, so that a refusal of megabytes takes no longer than another.
        shown = repr(value[: 2 * _LONGEST_VALUE] if isinstance(value, str | bytes) else value)
    except Exception as error:  # the repr of a foreign class may raise anything
        if isinstance(value, int):
            shown = f"a whole number of about {round(value.bit_length() * math.log10(2))} digits"
        else:
            shown = f"an object of type {type(value).__name__} (its repr raises {type(error).__name__})"
    line = " ".join(shown[: 20 * _LONGEST_VALUE].split())
    return line if len(line) <= _LONGEST_VALUE else line[: _LONGEST_VALUE - 1] + "…"


def how_to_install(extra: str) -> str:
    """Say how an extra of this package is installed, as the second half of a sentence without its full stop."""
    return f"`pip install 'usnet[{extra}]'` installs it"


def is_whole_number(value: object) -> bool:
    """Whether ``value`` is an integer of Python or NumPy; a boolean is not."""
    return isinstance(value, int | np.integer) and not isinstance(value, bool)


def whole_number(name: str, value: Any, least: int, most: int | None = None) -> int:
    """Return the argument ``name`` as an ``int``.

    Args:
        name: the argument's name in error messages.
        value: an integer of Python or NumPy, or an array of shape ``()`` that holds one.
        least: the smallest valid value.
        most: the largest valid value; ``None`` for no limit.

    Raises:
        ArgumentError: the value is not a whole number, or it is out of range.
    """
    plain = _to_python(value)
    if not is_whole_number(plain) or plain < least or (most is not None and plain > most):
        limits = f"from {least}" if most is None else f"from {least} to {most}"
        raise ArgumentError(f"{name} must be a whole number {limits}, got {quote(value)}.")
    return int(plain)


def real_number(name: str, value: Any, least: float, most: float) -> float:
    """Return the argument ``name`` as a ``float``; parameters and errors are those of :func:`whole_number`."""
    plain = _to_python(value)
    if isinstance(plain, bool) or not isinstance(plain, int | float) or not least <= plain <= most:
        raise ArgumentError(f"{name} must be a number from {least:g} to {most:g}, got {quote(value)}.")
    return float(plain)


def optional_seed(name: str, value: Any) -> int | None:
    """Return a seed as an ``int``, or ``None`` if it is ``None``.

    Raises:
        ArgumentError: the value is neither ``None`` nor a whole number from 0.
    """
    if value is None:
        return None
    plain = _to_python(value)
    if not is_whole_number(plain) or plain < 0:
        raise ArgumentError(f"{name} must be a whole number from 0 or None, got {quote(value)}.")
    return int(plain)


def plain_text(name: str, value: Any) -> str:
    """Return the argument ``name``, which must be a ``str``.

    Raises:
        ArgumentError: the value has another type.
    """
    if not isinstance(value, str):
        raise ArgumentError(f"{name} must be a text, got {quote(value)}.")
    return value


def named_values(name: str, value: Any) -> dict[str, Any]:
    """Return the argument ``name``, which must be a mapping of names to values or ``None``, as a new dictionary.

    Raises:
        ArgumentError: the value is neither.
    """
    if value is None:
        return {}
    if not isinstance(value, Mapping) or not all(isinstance(key, str) for key in value):
        raise ArgumentError(f"{name} must be a mapping of names to values, got {quote(value)}.")
    return dict(value)


def suggest_name(got: object, known: Collection[str]) -> str:
    """Ask for the most similar known name, in any case, as the end of a sentence; an empty text if none is similar."""
    by_case = {name.casefold(): name for name in known}
    near = get_close_matches(got.casefold(), by_case, n=1) if isinstance(got, str) else []
    return f" (did you mean {by_case[near[0]]!r}?)" if near else ""


def unknown_name(argument: str, got: object, known: Iterable[str]) -> ArgumentError:
    """The error for a name that is not registered; it suggests the most similar known name."""
    names = sorted(known)
    return ArgumentError(f"{argument} must be one of {', '.join(names)}, got {quote(got)}{suggest_name(got, names)}.")


def _to_python(value: Any) -> Any:
    """Convert NumPy scalars and arrays, lists and paths to the plain Python values that strict types accept."""
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray):
        if value.ndim:
            return tuple(value.tolist())
        return value if value.dtype == object else value.item()  # an array of an object stays what it is
    if isinstance(value, PurePath):
        return str(value)
    if isinstance(value, list):
        return tuple(item.item() if isinstance(item, np.generic) else item for item in value)
    return value


def _is_declared(field: FieldInfo | None, kind: type) -> bool:
    """Whether ``kind`` is a list or an array, and the argument is declared as such."""
    if field is None or kind not in (list, np.ndarray):
        return False
    declared = field.annotation
    kinds = get_args(declared) if get_origin(declared) in (Union, UnionType) else (declared,)
    return any(kind in (some, get_origin(some)) for some in kinds)


def unknown_argument(
    name: str, owner: str, known: Iterable[str], instead: Mapping[str, str] = MappingProxyType({})
) -> ArgumentError:
    """The error for an argument that ``owner`` does not have.

    Args:
        name: the argument.
        owner: the class or function, for the message.
        known: the arguments that it has; the most similar one is suggested.
        instead: what to suggest in place of that, by the name of an argument that similar classes have.
    """
    takes = list(known)
    hint = f" ({instead[name]})" if name in instead else suggest_name(name, takes)
    return ArgumentError(f"{name} is not an argument of {owner}{hint}; it takes {', '.join(takes)}.")


def _to_sentence(error: ValidationError) -> str:
    """The first error that pydantic found, as one sentence."""
    first = error.errors()[0]
    name = str(first["loc"][0]) if first["loc"] else "configuration"
    if first["type"] == "value_error":  # raised by a validator of this project: its text is the sentence
        return str(first["ctx"]["error"])
    if first["type"] == "literal_error":
        return str(unknown_name(name, first["input"], re.findall(r"'([^']*)'", first["ctx"]["expected"])))
    if first["type"] == "missing" and len(first["loc"]) == 1:
        return f"{name} must be given."
    takes = _EXPECTED.get(first["type"], first["msg"].removeprefix("Input should be ").rstrip("."))
    if "Sequence" in takes:
        takes = _EXPECTED["tuple_type"]
    if takes == _EXPECTED["tuple_type"] and isinstance(first["input"], str) and "," in first["input"]:
        takes += f" such as [{first['input'][:_LONGEST_VALUE]}]"
    return f"{name} must be {takes}, got {quote(first['input'])}."


class Config(BaseModel):
    """A frozen, strictly typed configuration; an invalid value raises :class:`ArgumentError`.

    The descriptions of the fields, if they have any, become the section ``Args`` of the docstring.

    Attributes:
        instead: arguments that this configuration does not have and similar ones do, and what to say about each.
    """

    instead: ClassVar[Mapping[str, str]] = {}

    model_config = ConfigDict(
        frozen=True, strict=True, extra="forbid", allow_inf_nan=False, arbitrary_types_allowed=True
    )

    def __init__(self, **values: Any) -> None:
        try:
            super().__init__(**values)
        except ValidationError as error:
            for found in error.errors():
                if found["type"] == "extra_forbidden":
                    owner = type(self)
                    raise unknown_argument(
                        str(found["loc"][0]), owner.__name__, owner.model_fields, owner.instead
                    ) from None
            raise ArgumentError(_to_sentence(error)) from None

    @model_validator(mode="before")
    @classmethod
    def _plain_values(cls, values: Any) -> Any:
        if isinstance(values, dict):
            return {
                name: value if _is_declared(cls.model_fields.get(name), type(value)) else _to_python(value)
                for name, value in values.items()
            }
        return values

    @classmethod
    def __pydantic_init_subclass__(cls, **values: Any) -> None:
        super().__pydantic_init_subclass__(**values)
        described = {name: field.description for name, field in cls.model_fields.items() if field.description}
        if described and cls.__doc__ and "Args:" not in cls.__doc__:
            lines = "".join(f"        {name}: {text}.\n" for name, text in described.items())
            summary, raises, errors = cls.__doc__.rstrip().partition("    Raises:")
            cls.__doc__ = f"{summary.rstrip()}\n\n    Args:\n{lines}\n{raises}{errors}"

    def part(self, kind: type[ConfigT], **changes: Any) -> ConfigT:
        """The values of those fields that another config has too, with changes, as this config."""
        shared = [name for name in kind.model_fields if name in type(self).model_fields and name not in changes]
        return kind(**{name: getattr(self, name) for name in shared}, **changes)


def describe_arguments(config: BaseModel) -> dict[str, Any]:
    """The arguments in a config, as JSON holds them; an argument that is an object is kept as its text."""
    return {
        name: value if isinstance(value, str | int | float | tuple | None) else quote(value)
        for name, value in ((name, getattr(config, name)) for name in type(config).model_fields)
    }


def takes_arguments(
    config: Callable[P, ConfigT],
) -> Callable[[Callable[[OwnerT, ConfigT], None]], Callable[Concatenate[OwnerT, P], None]]:
    """Decorate a constructor that takes a config, so that it takes the fields of the config as keyword arguments.

    The signature and the types of the arguments are those of the config. An unknown keyword raises
    :class:`ArgumentError` with a suggestion.

    Args:
        config: a subclass of :class:`Config`.
    """
    fields: Mapping[str, Any] = config.model_fields  # type: ignore[attr-defined]  # a class, typed by its constructor

    def decorate(init: Callable[[OwnerT, ConfigT], None]) -> Callable[Concatenate[OwnerT, P], None]:
        def checked(self: OwnerT, /, *none: P.args, **values: P.kwargs) -> None:
            for name in values:
                if name not in fields:
                    raise unknown_argument(name, type(self).__name__, fields, config.instead)  # type: ignore[attr-defined]
            init(self, config(*none, **values))

        types = get_type_hints(config)
        keywords = [
            Parameter(
                name,
                Parameter.KEYWORD_ONLY,
                default=Parameter.empty if field.is_required() else field.default,
                annotation=types[name],
            )
            for name, field in fields.items()
        ]
        update_wrapper(checked, init)
        checked.__signature__ = Signature(  # type: ignore[attr-defined]
            [Parameter("self", Parameter.POSITIONAL_OR_KEYWORD), *keywords], return_annotation=None
        )
        checked.config = config  # type: ignore[attr-defined]
        return checked

    return decorate


def list_arguments(**parts: str) -> Callable[[ClassT], ClassT]:
    """Decorate a class whose constructor :func:`takes_arguments`, to complete its docstring.

    Args:
        parts: texts by name: each replaces its name in braces. A table of the arguments replaces ``{arguments}``.
    """

    def complete(described: ClassT) -> ClassT:
        rows = [
            f"    | `{name}` | {_format_default(field)} | {field.description.replace('``', '`')} |"
            for name, field in vars(described)["__init__"].config.model_fields.items()
        ]
        table = "\n".join(["| name | default | meaning |", "    | --- | --- | --- |", *rows])
        text = described.__doc__ or ""  # Python leaves docstrings out with -OO
        for name, part in {**parts, "arguments": table}.items():
            text = text.replace(f"{{{name}}}", part)
        described.__doc__ = text
        return described

    return complete


def _format_default(field: FieldInfo) -> str:
    if field.is_required():
        return "required"
    value = field.default
    if isinstance(value, int | float) and not isinstance(value, bool):
        return f"{value:g}"
    return f"`{value!r}`".replace("'", '"')
