"""Checked arguments: the base class of all configurations, and sentences for values that are refused."""

from __future__ import annotations

import math
import re
import reprlib
from collections.abc import Callable, Iterable, Mapping
from difflib import get_close_matches
from functools import update_wrapper
from inspect import Parameter, Signature, signature
from pathlib import PurePath
from typing import Annotated, Any, ClassVar, Concatenate, ParamSpec, TypeVar

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator
from pydantic.fields import FieldInfo

P = ParamSpec("P")
OwnerT = TypeVar("OwnerT")
ConfigT = TypeVar("ConfigT", bound="Config")
ClassT = TypeVar("ClassT", bound=type)

Count = Annotated[int, Field(ge=1, le=100_000)]  # a number of UAVs, clusters or steps
Positive = Annotated[float, Field(gt=0)]

_MAX_LENGTH = 80
_SHORT_REPR = reprlib.Repr()  # looks at the first items of a long value only, and a few levels deep
_SHORT_REPR.maxstring = _SHORT_REPR.maxother = 200
_SHORT_REPR.maxlist = _SHORT_REPR.maxtuple = 30
_SHORT_REPR.maxlevel = 3

#: The module of each optional package, and the extra that brings it.
EXTRAS = {"torch": "torch", "matplotlib": "render", "rerun": "replay", "ray": "ray", "pettingzoo": "multiagent"}
EXTRAS |= dict.fromkeys(("pyarrow", "pyproj", "pyulog", "h5py", "pymavlink", "rosbags"), "tracks")

_EXPECTED = {  # texts for pydantic's error types
    "int_type": "a whole number",
    "string_type": "a name",
    "tuple_type": "a list",
    "list_type": "a list",
    "missing": "a longer list",
    "too_short": "a list of length {min_length} or more",
    "too_long": "a list of length {max_length} or less",
}


class ArgumentError(ValueError):
    """An argument is invalid; the message is one sentence with its name, its value and what it takes."""


class MissingExtraError(ImportError):
    """An optional package is not installed; the message gives the command that installs it."""


def how_to_install(extra: str) -> str:
    """Say how an extra of this package is installed, as the second half of a sentence without its full stop."""
    return f"`pip install 'usnet[{extra}]'` installs it"


def missing_extra(user: str, error: BaseException) -> MissingExtraError | None:
    """The error of a user, as ``"detector 'gassl'"``, if ``error`` is about a package of an extra, or ``None``."""
    module = (error.name or "").partition(".")[0] if isinstance(error, ModuleNotFoundError) else ""
    return MissingExtraError(f"{user} needs {module}; {how_to_install(EXTRAS[module])}.") if module in EXTRAS else None


def printable(text: object) -> str:
    """The text without characters that would control a terminal."""
    return "".join(filter(str.isprintable, str(text)))


def format_count(number: int, noun: str) -> str:
    """Format a number with its noun: ``1 head``, ``2 heads``."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def list_names(names: Iterable[object], most: int, ending: str = " and {} more") -> str:
    """The first ``most`` names with commas; if there are more, an ending, in which ``{}`` is their number."""
    texts = [str(name) for name in names]
    return ", ".join(texts[:most]) + (ending.format(len(texts) - most) if len(texts) > most else "")


def format_number(value: float, digits: int = 6) -> str:
    """Format a number with some significant digits, and from 1 to 10**12 without an exponent: ``880``, ``0.5``."""
    return f"{float(f'{value:.{digits}g}'):.12g}"


def choose_unit(seconds: float) -> tuple[str, int]:
    """The unit in which a time reads best, ``"s"`` below ten minutes and up to ``"days"``, and its seconds."""
    units = (("days", 86_400, 2), ("h", 3_600, 2), ("min", 60, 10))
    return next(((unit, size) for unit, size, least in units if seconds >= least * size), ("s", 1))


def format_seconds(seconds: float, digits: int = 6) -> str:
    """Format a time: ``399.5 s``, ``15 min``, ``10 days``."""
    unit, size = choose_unit(seconds)
    return f"{format_number(seconds / size, digits if size == 1 else min(digits, 3))} {unit}"


def quote(value: object) -> str:
    """Format ``value`` for an error message: its ``repr`` on one line of at most 80 characters."""
    text = _SHORT_REPR.repr(value[: 2 * _MAX_LENGTH] if isinstance(value, str | bytes) else value)
    line = " ".join(text.split())
    return line if len(line) <= _MAX_LENGTH else line[: _MAX_LENGTH - 1] + "…"


def whole_number(name: str, value: Any, least: int, most: float = math.inf) -> int:
    """Return the argument ``name``, an integer of Python or NumPy within its limits, as an ``int``."""
    number = _to_python(value)
    if isinstance(number, bool) or not isinstance(number, int) or not least <= number <= most:
        limits = f"from {least}" if most == math.inf else f"from {least} to {most}"
        raise ArgumentError(f"{name} must be a whole number {limits}, got {quote(value)}.")
    return int(number)


def real_number(name: str, value: Any, least: float, most: float) -> float:
    """Return the argument ``name``, a number within its limits, as a ``float``."""
    number = _to_python(value)
    if isinstance(number, bool) or not isinstance(number, int | float) or not least <= number <= most:
        raise ArgumentError(f"{name} must be a number from {least:g} to {most:g}, got {quote(value)}.")
    return float(number)


def instance_of(name: str, value: Any, kind: type) -> None:
    """Refuse the argument ``name`` if it is no object of a class."""
    if not isinstance(value, kind):
        raise ArgumentError(f"{name} must be an object of {kind.__name__}, got {quote(value)}.")


def optional_seed(name: str, value: Any) -> int | None:
    """Return a seed, a whole number from 0, as an ``int``, or ``None`` if it is ``None``."""
    return None if value is None else whole_number(name, value, 0)


def named_values(name: str, value: Any) -> dict[str, Any]:
    """Return the argument ``name``, a mapping of names to values or ``None``, as a new dictionary."""
    if not isinstance(value, Mapping | None) or not all(isinstance(key, str) for key in value or ()):
        raise ArgumentError(f"{name} must be a mapping of names to values, got {quote(value)}.")
    return dict(value or {})


def _suggest_name(got: object, known: Iterable[str]) -> str:
    """Ask for the most similar known name, in any case, as the end of a sentence; an empty text if none is similar."""
    by_case = {name.casefold(): name for name in known}
    matches = get_close_matches(got.casefold(), by_case, n=1) if isinstance(got, str) else []
    return f" (did you mean {by_case[matches[0]]!r}?)" if matches else ""


def unknown_name(argument: str, got: object, known: Iterable[str]) -> ArgumentError:
    """The error for a name that is not registered; it suggests the most similar known name."""
    names = sorted(known)
    return ArgumentError(f"{argument} must be one of {', '.join(names)}, got {quote(got)}{_suggest_name(got, names)}.")


def unknown_argument(
    name: str, owner: str, known: Iterable[str], instead: Mapping[str, str] | None = None
) -> ArgumentError:
    """The error for an argument that ``owner`` does not have; it suggests a similar one, or what ``instead`` says."""
    hint = f" ({instead[name]})" if instead and name in instead else _suggest_name(name, known)
    return ArgumentError(f"{name} is not an argument of {owner}{hint}; it takes {', '.join(known) or 'none'}.")


def _to_python(value: Any) -> Any:
    """Convert NumPy scalars and arrays, lists and paths to the plain Python values that strict types accept."""
    if isinstance(value, np.generic | np.ndarray):
        return value.item() if value.ndim == 0 else tuple(value.tolist())
    if isinstance(value, list):
        return tuple(item.item() if isinstance(item, np.generic) else item for item in value)
    return str(value) if isinstance(value, PurePath) else value


def _to_sentence(error: ValidationError, config: type[Config]) -> str:
    """The first of the innermost errors that pydantic found, an unknown argument before others, as one sentence."""
    fault = min(error.errors(), key=lambda detail: (detail["type"] != "extra_forbidden", -len(detail["loc"])))
    name = str(fault["loc"][0]) if fault["loc"] else "configuration"
    match fault["type"]:
        case "extra_forbidden":
            owner = config.__name__.replace("Arguments", "Env")
            return str(unknown_argument(name, owner, config.model_fields, config.instead))
        case "value_error":  # raised by a validator of this project: its text is the sentence
            return str(fault["ctx"]["error"])
        case "literal_error":
            return str(unknown_name(name, fault["input"], re.findall(r"'([^']*)'", fault["ctx"]["expected"])))
        case "missing" if len(fault["loc"]) == 1:
            return f"{name} must be given."
    expected = _EXPECTED.get(fault["type"], "").format_map(fault.get("ctx", {}))
    expected = expected or fault["msg"].removeprefix("Input should be ").rstrip(".")
    expected = "a list, such as [7, 5]" if expected == "a list" or "Sequence" in expected else expected
    item = "".join(f"[{key!r}]" for key in fault["loc"][2:3])  # of a list or mapping that is one of several forms
    return f"{name}{item} must be {expected}, got {quote(fault['input'])}."


class Config(BaseModel):
    """A frozen, strictly typed configuration; an invalid value raises :class:`ArgumentError`.

    ``instead`` says, about arguments that this configuration does not have and similar ones do, what to use.
    """

    instead: ClassVar[Mapping[str, str]] = {}

    model_config = ConfigDict(
        frozen=True, strict=True, extra="forbid", allow_inf_nan=False, arbitrary_types_allowed=True
    )

    def __init__(self, **values: Any) -> None:
        try:
            super().__init__(**values)
        except ValidationError as error:
            raise ArgumentError(_to_sentence(error, type(self))) from None

    @model_validator(mode="before")
    @classmethod
    def _plain_values(cls, values: Any) -> Any:
        if not isinstance(values, dict):  # a config in another one
            return values
        fields = cls.model_fields
        declared = {  # of arguments that are declared as a list or an array
            name: value
            for name, value in values.items()
            if isinstance(value, list | np.ndarray)
            and name in fields
            and type(value).__name__ in str(fields[name].annotation)
        }
        return {name: _to_python(value) for name, value in values.items()} | declared

    def part(self, kind: type[ConfigT], **changes: Any) -> ConfigT:
        """The values of those fields that another config has too, with changes, as this config."""
        return kind(**{name: value for name, value in self if name in kind.model_fields} | changes)


def describe_arguments(config: BaseModel) -> dict[str, Any]:
    """The arguments in a config, as JSON holds them; an argument that is an object is kept as its text."""
    return {
        name: value if isinstance(value, str | int | float | tuple | None) else quote(value) for name, value in config
    }


def takes_arguments(
    config: Callable[P, ConfigT],
) -> Callable[[Callable[[OwnerT, ConfigT], None]], Callable[Concatenate[OwnerT, P], None]]:
    """Decorate a constructor that takes a :class:`Config`, so that it takes the fields of the config as keywords."""

    def decorate(init: Callable[[OwnerT, ConfigT], None]) -> Callable[Concatenate[OwnerT, P], None]:
        def checked(self: OwnerT, /, *positional: P.args, **values: P.kwargs) -> None:
            init(self, config(*positional, **values))

        keywords = signature(config).parameters.values()
        wrapper: Any = update_wrapper(checked, init)
        wrapper.__signature__ = Signature([Parameter("self", Parameter.POSITIONAL_OR_KEYWORD), *keywords])
        wrapper.config = config
        return checked

    return decorate


def list_arguments(**parts: str) -> Callable[[ClassT], ClassT]:
    """Decorate a class, to replace ``{arguments}`` in its docstring by a table of them, and names of texts by these."""

    def complete(cls: ClassT) -> ClassT:
        rows = [
            f"    | `{name}` | {_format_default(field)} | {field.description.replace('``', '`')} |"
            for name, field in vars(cls)["__init__"].config.model_fields.items()
        ]
        table = "\n".join(["| name | default | meaning |", "    | --- | --- | --- |", *rows])
        for name, part in {**parts, "arguments": table}.items():
            cls.__doc__ = (cls.__doc__ or "").replace(f"{{{name}}}", part)
        return cls

    return complete


def _format_default(field: FieldInfo) -> str:
    value = field.default
    if isinstance(value, int | float) and not isinstance(value, bool):
        return f"{value:g}"
    return "required" if field.is_required() else f"`{value!r}`".replace("'", '"')
