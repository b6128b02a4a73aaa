"""Find and create detectors by name.

A name is one of three things: a name registered with :func:`register_detector` in this process; the name of an entry
point in the group ``usnet.detectors`` of an installed distribution, which is how the detectors of this package are
found; or ``module:Class``. Arguments may follow in brackets: ``lagged-regression(clusters=5)``. They are Python
literals, and reading them runs no code.
"""

from __future__ import annotations

import ast
import inspect
import re
import sys
import warnings
from collections.abc import Callable, Mapping
from contextlib import suppress
from difflib import get_close_matches
from hashlib import sha256
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from types import FunctionType, MappingProxyType
from typing import Any, Protocol, runtime_checkable
from weakref import WeakKeyDictionary

from usnet_env.config import ArgumentError, quote
from usnet_env.detection import Detection
from usnet_env.window import Window

__all__ = [
    "GROUP",
    "DetectorLike",
    "describe_detectors",
    "describe_foreign_detectors",
    "detector_label",
    "detector_names",
    "make_detector",
    "register_detector",
    "registered_detectors",
]

GROUP = "usnet.detectors"
_OWN_DISTRIBUTION, _OWN_PACKAGE = "usnet", "detectors"
_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]*")

Factory = Callable[..., Any]


@runtime_checkable
class DetectorLike(Protocol):
    """The methods that a detector needs; no base class is required."""

    def reset(self, seed: int | None = None) -> None:
        """Start an episode; ``seed`` seeds the detector's random numbers."""

    def detect(self, window: Window) -> Detection:
        """Return the answer for one window."""


_registered: dict[str, Factory] = {}
# Labels of detectors that a function created: such a detector does not know the name of the function.
_function_labels: WeakKeyDictionary[Any, str] = WeakKeyDictionary()


def register_detector(name: str, factory: Factory) -> None:
    """Register a detector under ``name`` in this process.

    Args:
        name: a new name of letters, digits, ``_``, ``.`` and ``-``.
        factory: a class or function that returns a detector when it is called with keyword arguments.

    Raises:
        ArgumentError: another detector has the name, the name has other characters, or the factory is not callable.
    """
    if not isinstance(name, str) or not _NAME.fullmatch(name):
        raise ArgumentError(f"name must consist of letters, digits, '_', '.' and '-', got {quote(name)}.")
    if not callable(factory):
        raise ArgumentError(f"factory must be a class or a function that returns a detector, got {quote(factory)}.")
    if _registered.get(name, factory) is not factory or (name not in _registered and name in _entry_points()):
        raise ArgumentError(f"name must be a new one, got {name!r}, which is registered already.")
    _registered[name] = factory


def registered_detectors() -> Mapping[str, Factory]:
    """The detectors that were registered in this process by name (a read-only view)."""
    return MappingProxyType(_registered)


def detector_names() -> list[str]:
    """Return the names of all registered and installed detectors in alphabetical order, without importing any."""
    return sorted({*_registered, *_entry_points()})


def describe_detectors() -> dict[str, str]:
    """Return a description of each detector by name: the first line of its docstring.

    If a detector can't be imported, its description and a warning give the reason; the others are not affected.
    """
    descriptions = {}
    for name in detector_names():
        try:
            descriptions[name] = (inspect.getdoc(_find_factory(name)) or "").partition("\n")[0]
        except ArgumentError as error:
            warnings.warn(str(error), stacklevel=2)
            descriptions[name] = f"not available: {error}"
    return descriptions


def make_detector(name: str, /, **arguments: Any) -> DetectorLike:
    """Create a detector.

    Args:
        name: a registered name or ``module:Class``, with or without arguments in brackets:
            ``"lagged-regression(clusters=5)"``.
        arguments: further arguments of the detector's constructor.

    Returns:
        The detector, before its first reset.

    Raises:
        ArgumentError: there is no such detector, it can't be imported, or its constructor doesn't take the arguments.
    """
    plain, given = _parse_name(name, arguments)
    factory = _find_factory(plain)
    _check_arguments(plain, factory, given)
    try:
        detector = factory(**given)
    except ArgumentError:
        raise
    except (Exception, SystemExit) as error:
        raise ArgumentError(f"detector {plain!r} could not be made: {_describe_error(error)}.") from error
    if isinstance(detector, type) or not isinstance(detector, DetectorLike):
        raise ArgumentError(
            f"detector {plain!r} must have the methods detect(window) and reset(seed), got {quote(detector)}."
        )
    if factory is not type(detector):
        with suppress(TypeError):  # a detector that cannot be hashed or weakly referenced is labelled by its class
            _function_labels[detector] = _format_label(plain, given)
    return detector


def detector_label(detector: Any, arguments: Mapping[str, Any] | None = None) -> str:
    """Return the label of a detector in tables, such as ``lagged-regression(clusters=5)``.

    Args:
        detector: a name as :func:`make_detector` takes it, or a detector. The label of a detector object is the name
            under which its class is registered, or the name of its class, with all arguments that differ from their
            defaults.
        arguments: further arguments, if ``detector`` is a name.

    Returns:
        The name, followed by the arguments, if any, in brackets and in alphabetical order.

    Raises:
        ArgumentError: the name can't be parsed, or arguments are given for a detector object.
    """
    if not isinstance(arguments, Mapping | None):
        raise ArgumentError(f"arguments must be a mapping of names to values, got {quote(arguments)}.")
    if isinstance(detector, str):
        return _format_label(*_parse_name(detector, arguments or {}))
    if arguments:
        raise ArgumentError(f"arguments must be empty if detector is an object, got {quote(arguments)}.")
    with suppress(TypeError):
        if detector in _function_labels:
            return _function_labels[detector]
    detector_class = type(detector)
    return _format_label(_find_registered_name(detector_class) or detector_class.__name__, _changed_arguments(detector))


def _format_label(name: str, arguments: Mapping[str, Any]) -> str:
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


def _find_registered_name(detector_class: type) -> str | None:
    """Find the name under which a class is registered; imports only entry points to a class of the same name."""
    for name, factory in _registered.items():
        if factory is detector_class:
            return name
    for name, point in _entry_points().items():
        if point.attr == detector_class.__qualname__:
            try:
                if _find_factory(name) is detector_class:
                    return name
            except ArgumentError:
                continue
    return None


def _changed_arguments(detector: Any) -> dict[str, Any]:
    """Return the constructor's arguments that differ from their defaults, read from attributes of the same name."""
    return {
        name: getattr(detector, name)
        for name, parameter in _named_parameters(type(detector)).items()
        if hasattr(detector, name) and not _are_equal(getattr(detector, name), parameter.default)
    }


def _are_equal(one: Any, other: Any) -> bool:
    """Compare two values of any type; values whose comparison is not a single truth value are not equal."""
    try:
        return one is other or (type(one) is type(other) and bool(one == other))
    except Exception:  # the comparison of a foreign class may raise anything
        return False


def _named_parameters(factory: Factory) -> dict[str, inspect.Parameter]:
    """Return the parameters that can be given by name; an empty dictionary if the signature can't be read."""
    try:
        parameters = inspect.signature(factory).parameters
    except (TypeError, ValueError):
        return {}
    by_name = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)
    return {name: parameter for name, parameter in parameters.items() if parameter.kind in by_name}


def _check_arguments(name: str, factory: Factory, arguments: Mapping[str, Any]) -> None:
    try:
        parameter_kinds = {parameter.kind for parameter in inspect.signature(factory).parameters.values()}
    except (TypeError, ValueError):  # a class written in C may have no signature: the call then reports wrong arguments
        return
    known = _named_parameters(factory)
    takes = f"it takes {', '.join(known)}" if known else "it takes no arguments"
    if inspect.Parameter.VAR_KEYWORD not in parameter_kinds:
        for argument in arguments:
            if argument not in known:
                near = get_close_matches(argument, known, n=1)
                hint = f" (did you mean {near[0]!r}?)" if near else ""
                raise ArgumentError(f"detector {name!r} has no argument {argument!r}{hint}; {takes}.")
    for argument, parameter in known.items():
        if parameter.default is parameter.empty and argument not in arguments:
            raise ArgumentError(f"detector {name!r} needs the argument {argument!r}; {takes}.")


def _parse_name(text: Any, more: Mapping[str, Any]) -> tuple[str, dict[str, Any]]:
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


def _entry_points() -> dict[str, EntryPoint]:
    """Return the entry points of the group by name.

    The detectors of this package keep their names if another distribution uses them too. An entry point that can't be
    loaded because it is malformed is ignored with a warning.
    """
    found: dict[str, EntryPoint] = {}
    for point in sorted(entry_points(group=GROUP), key=_sort_key):
        if EntryPoint.pattern.match(point.value) is None or not _NAME.fullmatch(point.name):
            warnings.warn(
                f"detector {point.name!r} of {_distribution_name(point)} is ignored: an entry point must be written "
                f"name = module:Class, got {quote(f'{point.name} = {point.value}')}.",
                stacklevel=3,
            )
            continue
        taken = found.setdefault(point.name, point)
        if taken.value != point.value:
            warnings.warn(
                f"detector {point.name!r} of {_distribution_name(point)} is ignored, because "
                f"{_distribution_name(taken)} has a detector of the same name.",
                stacklevel=3,
            )
    return found


def _distribution_name(point: EntryPoint) -> str:
    try:
        name = point.dist.name if point.dist is not None else None
    except Exception:  # a partly removed distribution may have no metadata
        name = None
    return name or "an unnamed distribution"


def _sort_key(point: EntryPoint) -> tuple[bool, str]:
    name = _distribution_name(point)
    return name != _OWN_DISTRIBUTION, name


def _find_factory(name: str) -> Factory:
    """Return the class or function for a name without brackets."""
    if name in _registered:
        return _registered[name]
    points = _entry_points()
    if name in points:
        return _load_factory(name, points[name].load)
    module, colon, attribute = name.partition(":")
    if colon and module and attribute:
        return _load_factory(name, lambda: _import_attribute(module, attribute))
    known = sorted({*_registered, *points})
    near = get_close_matches(name, known, n=1)
    hint = f" (did you mean {near[0]!r}?)" if near else ""
    raise ArgumentError(f"detector must be one of {', '.join(known)}, or module:Class, got {quote(name)}{hint}.")


def _import_attribute(module: str, path: str) -> Any:
    target: Any = import_module(module)
    for part in path.split("."):
        target = getattr(target, part)
    return target


def _load_factory(name: str, load: Callable[[], Any]) -> Factory:
    try:
        factory = load()
    except (Exception, SystemExit) as error:  # importing a foreign module may raise anything
        if reason := describe_foreign_detectors():
            raise ArgumentError(f"detector {name!r} can't be loaded: {reason}") from error
        raise ArgumentError(f"detector {name!r} can't be loaded: {_describe_error(error)}.") from error
    if not callable(factory):
        raise ArgumentError(
            f"detector {name!r} must be a class or a function that returns a detector, got {quote(factory)}."
        )
    loaded: Factory = factory
    return loaded


def describe_foreign_detectors() -> str | None:
    """Describe an imported package ``detectors`` that is not the one of this distribution; ``None`` without one.

    The name is a common one: a folder of the user may come first on the path, and another distribution may have
    overwritten the package.
    """
    package = sys.modules.get(_OWN_PACKAGE)
    if package is None or hasattr(package, "DetectorPolicy"):
        return None
    place = next(iter(getattr(package, "__path__", [])), package.__file__)  # a module has no path
    return (
        f"the package {_OWN_PACKAGE!r} that Python found is not that of {_OWN_DISTRIBUTION}: rename {place!r}, or "
        f"remove the distribution that it belongs to and install {_OWN_DISTRIBUTION} again."
    )


def _describe_error(error: BaseException) -> str:
    """Describe an exception on one line."""
    text = " ".join(str(error).split()).rstrip(".")
    return f"{type(error).__name__}: {text}" if text else type(error).__name__
