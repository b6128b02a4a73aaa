"""Find and create detectors by name.

A name is one of three things: a name registered with :func:`register_detector` in this process; the name of an entry
point in the group ``usnet.detectors`` of an installed distribution, which is how the detectors of this package are
found; or ``module:Class``. Arguments may follow in brackets: ``lagged-regression(clusters=5)``. They are Python
literals, and reading them runs no code. Listing detectors runs no code of theirs either: their descriptions are read
from the source files.
"""

from __future__ import annotations

import inspect
import re
import sys
import warnings
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from importlib import import_module
from importlib.util import find_spec
from operator import attrgetter
from typing import Any, Protocol, runtime_checkable
from weakref import WeakKeyDictionary

from usnet_env.config import ArgumentError, named_values, quote, unknown_name
from usnet_env.definitions import find_definition
from usnet_env.detection import Detection, Tags, read_tags
from usnet_env.labels import format_label, parse_label
from usnet_env.registry import OWN_DISTRIBUTION, Registry, are_equal, check_call, describe_error, named_parameters
from usnet_env.window import Window

_OWN_PACKAGE = "detectors"
Factory = Callable[..., Any]


@runtime_checkable
class DetectorLike(Protocol):
    """The methods that a detector needs; no base class is required."""

    def reset(self, seed: int | None = None) -> None:
        """Start an episode; ``seed`` seeds the detector's random numbers."""

    def detect(self, window: Window) -> Detection:
        """Return the answer for one window."""


# Labels of detectors that a function created: such a detector does not know the name of the function.
_function_labels: WeakKeyDictionary[Any, str] = WeakKeyDictionary()


def _check_factory(factory: Any, subject: str = "factory") -> Factory:
    if not callable(factory):
        raise ArgumentError(f"{subject} must be a class or a function that returns a detector, got {quote(factory)}.")
    return factory


#: All detectors by name: classes, and functions that return a detector.
DETECTORS = Registry(
    "detector",
    "detector",
    "usnet.detectors",
    __name__,
    _check_factory,
    form=(re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]*"), "consist of letters, digits, '_', '.' and '-'"),
    classes=True,
)


def register_detector(name: str, factory: Factory, *, replace: bool = False) -> None:
    """Register a detector under ``name`` in this process.

    Args:
        name: a new name of letters, digits, ``_``, ``.`` and ``-``.
        factory: a class or function that returns a detector when it is called with keyword arguments.
        replace: whether to replace a detector that was registered under this name before, as a notebook does when a
            cell is run again. The name of an installed detector cannot be replaced.

    Raises:
        ArgumentError: another detector has the name, the name has other characters, or the factory is not callable.
    """
    DETECTORS.register(name, factory, replace=replace)


def detector_names() -> list[str]:
    """Return the names of all registered and installed detectors in alphabetical order, without importing any."""
    return sorted(DETECTORS)


@dataclass(frozen=True)
class DetectorEntry:
    """A registered or installed detector.

    Args:
        name: its name.
        description: the first line of its docstring, or ``not available`` with the reason.
        tags: what it declares to need and to use.
    """

    name: str
    description: str
    tags: Tags = field(default_factory=Tags)

    @property
    def needs(self) -> tuple[str, ...]:
        """The packages that it needs beyond an installation of USNET without extras."""
        return self.tags.needs

    @property
    def missing(self) -> tuple[str, ...]:
        """Those of the needed packages that are not installed."""
        return tuple(package for package in self.needs if not _is_installed(package))


def list_detectors() -> list[DetectorEntry]:
    """List all detectors in alphabetical order, with a description and tags.

    Both are read from the source files; a detector is imported only if its class can't be found there. If a detector
    isn't available, its description and a warning give the reason; the others are not affected.
    """
    points = DETECTORS.entry_points()
    entries = []
    for name in sorted(DETECTORS):
        point = None if name in DETECTORS.registered else points[name]
        definition = None if point is None else find_definition(point.module, point.attr)
        try:
            if definition is not None:
                doc, tags = definition.docstring, _make_tags(name, definition.read_call("tags"))
            else:
                factory = _find_factory(name)
                doc, tags = inspect.getdoc(factory) or "", read_tags(factory)
            entries.append(DetectorEntry(name, doc.partition("\n")[0], tags))
        except ArgumentError as error:
            warnings.warn(str(error), stacklevel=2)
            entries.append(DetectorEntry(name, f"not available: {error}"))
    return entries


def describe_detectors() -> dict[str, str]:
    """Return a description of each detector by name: the first line of its docstring, as :func:`list_detectors`."""
    return {entry.name: entry.description for entry in list_detectors()}


def _make_tags(name: str, values: Mapping[str, Any]) -> Tags:
    try:
        return Tags(**values)
    except TypeError as error:
        raise ArgumentError(f"detector {name!r} must declare known tags: {describe_error(error)}.") from None


def _is_installed(package: str) -> bool:
    try:
        return find_spec(package) is not None
    except (ImportError, ValueError):
        return package in sys.modules


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
    plain, given = parse_label(name, arguments)
    factory = _find_factory(plain)
    check_call(f"detector {plain!r}", factory, given)
    try:
        detector = factory(**given)
    except ArgumentError:
        raise
    except (Exception, SystemExit) as error:
        raise ArgumentError(f"detector {plain!r} could not be made: {describe_error(error)}.") from error
    if isinstance(detector, type) or not isinstance(detector, DetectorLike):
        raise ArgumentError(
            f"detector {plain!r} must have the methods detect(window) and reset(seed), got {quote(detector)}."
        )
    if factory is not type(detector):
        with suppress(TypeError):  # a detector that cannot be hashed or weakly referenced is labelled by its class
            _function_labels[detector] = format_label(plain, given)
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
    named = named_values("arguments", arguments)
    if isinstance(detector, str):
        return format_label(*parse_label(detector, named))
    if named:
        raise ArgumentError(f"arguments must be empty if detector is an object, got {quote(arguments)}.")
    with suppress(TypeError):
        if detector in _function_labels:
            return _function_labels[detector]
    detector_class = type(detector)
    changed = {
        name: getattr(detector, name)
        for name, parameter in named_parameters(detector_class).items()
        if hasattr(detector, name) and not are_equal(getattr(detector, name), parameter.default)
    }
    return format_label(_find_registered_name(detector_class) or detector_class.__name__, changed)


def _find_registered_name(detector_class: type) -> str | None:
    """Find the name under which a class is registered; imports only entry points to a class of the same name."""
    for name, factory in DETECTORS.registered.items():
        if factory is detector_class:
            return name
    for name, point in DETECTORS.entry_points().items():
        if point.attr == detector_class.__qualname__:
            try:
                if _find_factory(name) is detector_class:
                    return name
            except ArgumentError:
                continue
    return None


def _find_factory(name: str) -> Factory:
    """Return the class or function for a name without brackets."""
    module, colon, attribute = name.partition(":")
    try:
        if name in DETECTORS:
            return DETECTORS[name]
        if colon and module and attribute:
            return DETECTORS.load(name, lambda: attrgetter(attribute)(import_module(module)))
    except ArgumentError as error:
        if reason := describe_foreign_detectors():
            raise ArgumentError(f"detector {name!r} can't be loaded: {reason}") from error
        raise
    raise unknown_name("detector", name, [*DETECTORS, "module:Class"])


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
        f"the package {_OWN_PACKAGE!r} that Python found is not that of {OWN_DISTRIBUTION}: rename {place!r}, or "
        f"remove the distribution that it belongs to and install {OWN_DISTRIBUTION} again."
    )
