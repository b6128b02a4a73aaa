"""Finds detectors by name: our own, a stranger's, or a class that is named outright.

A name is one of three things: what :func:`register_detector` was told in this process, an entry point of the group
``usnet.detectors`` of any installed distribution (our own detectors are found in this way as well), or
``module:Class``. Arguments may follow in brackets: ``lagged-regression(clusters=5)``. They are Python literals, read
without running anything.
"""

from __future__ import annotations

import ast
import inspect
import re
import warnings
from collections.abc import Callable, Mapping
from contextlib import suppress
from difflib import get_close_matches
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from types import FunctionType
from typing import Any, Protocol, runtime_checkable
from weakref import WeakKeyDictionary

from usnet_env.config import ArgumentError, quote, unknown_name
from usnet_env.detection import Detection
from usnet_env.window import Window

__all__ = [
    "GROUP",
    "DetectorLike",
    "describe_detectors",
    "detector_label",
    "detector_names",
    "make_detector",
    "register_detector",
]

GROUP = "usnet.detectors"
_OWN_DISTRIBUTION = "usnet"
_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]*")

Factory = Callable[..., Any]


@runtime_checkable
class DetectorLike(Protocol):
    """Whatever serves as a detector; no base class is needed."""

    def reset(self, seed: int | None = None) -> None:
        """Start an episode."""

    def detect(self, window: Window) -> Detection:
        """Answer one window."""


_registered: dict[str, Factory] = {}
# Labels of what a plain function made: its result doesn't tell where it comes from.
_made_by_function: WeakKeyDictionary[Any, str] = WeakKeyDictionary()


def register_detector(name: str, factory: Factory) -> None:
    """Make a detector available under ``name`` in this process.

    Args:
        name: letters, digits, ``_``, ``.`` and ``-``. A name that is taken by another detector is refused.
        factory: a class, or a function, that gives a detector when it is called with keyword arguments.

    Raises:
        ArgumentError: the name is taken or not a name, or the factory can't be called.
    """
    if not isinstance(name, str) or not _NAME.fullmatch(name):
        raise ArgumentError(f"name must consist of letters, digits, '_', '.' and '-', got {quote(name)}.")
    if not callable(factory):
        raise ArgumentError(f"factory must be a class or a function that makes a detector, got {quote(factory)}.")
    if _registered.get(name, factory) is not factory or (name not in _registered and name in _entry_points()):
        raise ArgumentError(f"name must be a new one, got {name!r}, which is registered already.")
    _registered[name] = factory


def detector_names() -> list[str]:
    """The names of all detectors that are registered or installed, in alphabetical order; none is imported."""
    return sorted({*_registered, *_entry_points()})


def describe_detectors() -> dict[str, str]:
    """One line about each detector, by name: the first of its docstring.

    A detector that can't be imported harms no other: a warning gives the reason, and so does its line.
    """
    lines = {}
    for name in detector_names():
        try:
            lines[name] = (inspect.getdoc(_factory(name)) or "").partition("\n")[0]
        except ArgumentError as error:
            warnings.warn(str(error), stacklevel=2)
            lines[name] = f"not available: {error}"
    return lines


def make_detector(name: str, /, **arguments: Any) -> DetectorLike:
    """Make a detector.

    Args:
        name: a registered name or ``module:Class``, with or without arguments in brackets:
            ``"lagged-regression(clusters=5)"``.
        arguments: more arguments of the detector's constructor.

    Returns:
        The detector, not yet reset.

    Raises:
        ArgumentError: no such detector, it can't be imported, or its constructor doesn't take the arguments.
    """
    plain, given = _parsed(name, arguments)
    factory = _factory(plain)
    _check_arguments(plain, factory, given)
    try:
        detector = factory(**given)
    except ArgumentError:
        raise
    except (Exception, SystemExit) as error:
        raise ArgumentError(f"detector {plain!r} could not be made: {_reason(error)}.") from error
    if isinstance(detector, type) or not isinstance(detector, DetectorLike):
        raise ArgumentError(
            f"detector {plain!r} must have the methods detect(window) and reset(seed), got {quote(detector)}."
        )
    if factory is not type(detector):
        with suppress(TypeError):  # it can't be hashed or weakly referenced: its class's name has to serve
            _made_by_function[detector] = _label(plain, given)
    return detector


def detector_label(detector: Any, arguments: Mapping[str, Any] | None = None) -> str:
    """How a detector is called in tables: ``lagged-regression(clusters=5)``.

    Args:
        detector: a name as :func:`make_detector` takes it, or a detector. A detector is called by the name that its
            class is registered under, or by its class's own, with those arguments that differ from the defaults.
        arguments: for a name, more arguments.

    Returns:
        The name, and its arguments in alphabetical order in brackets where there are any.

    Raises:
        ArgumentError: a name that can't be read, or arguments beside a detector that has been made.
    """
    if isinstance(detector, str):
        return _label(*_parsed(detector, arguments or {}))
    if arguments:
        raise ArgumentError(f"arguments must be empty for a detector that was already made, got {quote(arguments)}.")
    with suppress(TypeError):
        if detector in _made_by_function:
            return _made_by_function[detector]
    kind = type(detector)
    return _label(_registered_name(kind) or kind.__name__, _own_arguments(detector))


def _label(name: str, arguments: Mapping[str, Any]) -> str:
    listed = ", ".join(f"{key}={_told(arguments[key])}" for key in sorted(arguments))
    return f"{name}({listed})" if listed else name


def _told(value: Any) -> str:
    """A value as a label tells it: a function by its name, as its address differs from run to run."""
    return str(value.__qualname__) if isinstance(value, FunctionType) else quote(value)


def _registered_name(kind: type) -> str | None:
    """The name under which a class is known; imports nothing that doesn't bear its name."""
    for name, factory in _registered.items():
        if factory is kind:
            return name
    for name, point in _entry_points().items():
        if point.attr == kind.__qualname__:
            try:
                if _factory(name) is kind:
                    return name
            except ArgumentError:
                continue
    return None


def _own_arguments(detector: Any) -> dict[str, Any]:
    """The constructor's arguments that differ from their defaults, read from the attributes of the same names."""
    return {
        name: getattr(detector, name)
        for name, parameter in _parameters(type(detector)).items()
        if hasattr(detector, name) and not _same(getattr(detector, name), parameter.default)
    }


def _same(one: Any, other: Any) -> bool:
    """Equality that an array, whose comparison has no single answer, can't break."""
    try:
        return one is other or (type(one) is type(other) and bool(one == other))
    except Exception:  # a stranger's comparison may raise anything
        return False


def _parameters(factory: Factory) -> dict[str, inspect.Parameter]:
    """The parameters that can be given by name; an empty dictionary where the signature can't be read."""
    try:
        parameters = inspect.signature(factory).parameters
    except (TypeError, ValueError):
        return {}
    by_name = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)
    return {name: parameter for name, parameter in parameters.items() if parameter.kind in by_name}


def _check_arguments(name: str, factory: Factory, arguments: Mapping[str, Any]) -> None:
    try:
        kinds = {parameter.kind for parameter in inspect.signature(factory).parameters.values()}
    except (TypeError, ValueError):  # a class written in C may have none: calling it will tell
        return
    known = _parameters(factory)
    takes = f"it takes {', '.join(known)}" if known else "it takes none"
    if inspect.Parameter.VAR_KEYWORD not in kinds:
        for argument in arguments:
            if argument not in known:
                near = get_close_matches(argument, known, n=1)
                hint = f" (did you mean {near[0]!r}?)" if near else ""
                raise ArgumentError(f"detector {name!r} has no argument {argument!r}{hint}; {takes}.")
    for argument, parameter in known.items():
        if parameter.default is parameter.empty and argument not in arguments:
            raise ArgumentError(f"detector {name!r} needs the argument {argument!r}; {takes}.")


def _parsed(text: Any, more: Mapping[str, Any]) -> tuple[str, dict[str, Any]]:
    """Name and arguments of ``name(key=literal, ...)``."""
    if not isinstance(text, str) or not text.strip():
        raise ArgumentError(f"detector must be a name, got {quote(text)}.")
    name, bracket, inner = text.strip().partition("(")
    arguments = _literals(text, inner) if bracket else {}
    for argument in more:
        if argument in arguments:
            raise ArgumentError(f"{argument} must be given once, got it in {quote(text)} and beside it.")
    return name.strip(), {**arguments, **more}


def _literals(text: str, inner: str) -> dict[str, Any]:
    """The arguments in ``inner``, which is what follows the opening bracket of ``text``."""
    takes = f"detector must be written name(argument=value, ...) with Python literals as values, got {quote(text)}."
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", SyntaxWarning)  # what it warns of is refused below
            call = ast.parse(f"name({inner}", mode="eval").body
        if not isinstance(call, ast.Call) or not isinstance(call.func, ast.Name) or call.args:
            raise ArgumentError(takes)
        arguments: dict[str, Any] = {}
        for keyword in call.keywords:
            if keyword.arg is None or keyword.arg in arguments:
                raise ArgumentError(takes)
            arguments[keyword.arg] = ast.literal_eval(keyword.value)
    except (SyntaxError, ValueError, TypeError, MemoryError, RecursionError):
        raise ArgumentError(takes) from None
    return arguments


def _entry_points() -> dict[str, EntryPoint]:
    """The entry points of the group by name. A stranger can't take the name of a detector of ours.

    One that nobody could load is left out with a warning, so that it stands in nobody's way.
    """
    found: dict[str, EntryPoint] = {}
    for point in sorted(entry_points(group=GROUP), key=_foreign):
        if EntryPoint.pattern.match(point.value) is None or not _NAME.fullmatch(point.name):
            warnings.warn(
                f"detector {point.name!r} of {_distribution(point)} is ignored: an entry point must be written "
                f"name = module:Class, got {quote(f'{point.name} = {point.value}')}.",
                stacklevel=3,
            )
            continue
        taken = found.setdefault(point.name, point)
        if taken.value != point.value:
            warnings.warn(
                f"detector {point.name!r} of {_distribution(point)} is ignored, as {_distribution(taken)} has one of "
                "the same name.",
                stacklevel=3,
            )
    return found


def _distribution(point: EntryPoint) -> str:
    try:
        name = point.dist.name if point.dist is not None else None
    except Exception:  # half-removed distributions have lost their metadata
        name = None
    return name or "an unnamed distribution"


def _foreign(point: EntryPoint) -> tuple[bool, str]:
    name = _distribution(point)
    return name != _OWN_DISTRIBUTION, name


def _factory(name: str) -> Factory:
    """The class or function behind a name without brackets."""
    if name in _registered:
        return _registered[name]
    points = _entry_points()
    if name in points:
        return _loaded(name, points[name].load)
    module, colon, attribute = name.partition(":")
    if colon and module and attribute:
        return _loaded(name, lambda: _attribute(module, attribute))
    raise unknown_name("detector", name, {*_registered, *points, "module:Class"})


def _attribute(module: str, path: str) -> Any:
    target: Any = import_module(module)
    for part in path.split("."):
        target = getattr(target, part)
    return target


def _loaded(name: str, load: Callable[[], Any]) -> Factory:
    try:
        factory = load()
    except (Exception, SystemExit) as error:  # whatever happens while a stranger's module is imported
        raise ArgumentError(f"detector {name!r} can't be loaded: {_reason(error)}.") from error
    if not callable(factory):
        raise ArgumentError(f"detector {name!r} must be a class or a function that makes one, got {quote(factory)}.")
    made: Factory = factory
    return made


def _reason(error: BaseException) -> str:
    """An exception in a few words on one line."""
    text = " ".join(str(error).split()).rstrip(".")
    return f"{type(error).__name__}: {text}" if text else type(error).__name__
