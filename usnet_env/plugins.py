"""Find and create detectors by name.

A name is one of three things: a name registered with :func:`register_detector` in this process; the name of an entry
point in the group ``usnet.detectors`` of an installed distribution, which is how the detectors of this package are
found; or ``module:Class``. Arguments may follow in brackets: ``lagged-regression(clusters=5)``. They are Python
literals, and reading them runs no code. Listing detectors runs no code of theirs either: their descriptions are read
from the source files.
"""

from __future__ import annotations

import ast
import functools
import inspect
import os
import re
import sys
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from difflib import get_close_matches
from hashlib import sha256
from importlib import import_module
from importlib.machinery import ModuleSpec, PathFinder
from importlib.metadata import EntryPoint
from importlib.util import find_spec, resolve_name
from pathlib import Path
from types import FunctionType
from typing import Any, Protocol, runtime_checkable
from weakref import WeakKeyDictionary

from usnet_env.config import ArgumentError, quote, unknown_name
from usnet_env.detection import Detection
from usnet_env.registry import OWN_DISTRIBUTION, Registry, describe_error
from usnet_env.window import Window

__all__ = [
    "DETECTORS",
    "DetectorEntry",
    "DetectorLike",
    "describe_detectors",
    "describe_foreign_detectors",
    "detector_label",
    "detector_names",
    "list_detectors",
    "make_detector",
    "register_detector",
]

_OWN_PACKAGE = "detectors"
# The packages that an installation of USNET without extras has, by the names under which they are imported.
_ALWAYS_INSTALLED = frozenset(
    {"usnet_env", "detectors", "click", "gymnasium", "numba", "numpy", "pydantic", "rich", "scipy", "sklearn"}
    | {"threadpoolctl", "yaml"}
)
_REEXPORTS = 8  # limit of the chain of `from … import …` that leads to a class

Factory = Callable[..., Any]
Parse = Callable[[str], tuple[ast.Module | None, bool]]


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
        needs: the packages that its module imports and that an installation of USNET without extras doesn't have, in
            alphabetical order, such as ``("torch",)``.
        missing: those of ``needs`` that are not installed.
    """

    name: str
    description: str
    needs: tuple[str, ...] = ()
    missing: tuple[str, ...] = ()


def list_detectors() -> list[DetectorEntry]:
    """List all detectors in alphabetical order, with a description and the packages that they need.

    Both are read from the source files; a detector is imported only if its class can't be found there. If a detector
    isn't available, its description and a warning give the reason; the others are not affected.
    """
    points, parse = DETECTORS.entry_points(), functools.cache(_parse_module)
    entries = []
    for name in sorted(DETECTORS):
        needs = () if name in DETECTORS.registered else _find_needs(points[name].module, parse)
        missing = tuple(package for package in needs if not _is_installed(package))
        try:
            entries.append(DetectorEntry(name, _read_description(name, points, parse), needs, missing))
        except ArgumentError as error:
            warnings.warn(str(error), stacklevel=2)
            entries.append(DetectorEntry(name, f"not available: {error}", needs, missing))
    return entries


def describe_detectors() -> dict[str, str]:
    """Return a description of each detector by name: the first line of its docstring, as :func:`list_detectors`."""
    return {entry.name: entry.description for entry in list_detectors()}


def _read_description(name: str, points: Mapping[str, EntryPoint], parse: Parse) -> str:
    """Read the first line of the docstring, from the source file if it is an installed detector."""
    definition = None
    if name not in DETECTORS.registered:
        definition = _find_definition(points[name].module, points[name].attr, parse)
    doc = inspect.getdoc(_find_factory(name)) if definition is None else ast.get_docstring(definition)
    return (doc or "").partition("\n")[0]


def _find_module(module: str) -> ModuleSpec | None:
    """Find a module without importing it or the packages that contain it."""
    first, *rest = module.split(".")
    try:
        spec = find_spec(first)  # a module without a dot is found without an import
        for end in range(1, len(rest) + 1):
            if spec is None:
                return None
            spec = PathFinder.find_spec(".".join([first, *rest[:end]]), spec.submodule_search_locations or [])
    except (ImportError, ValueError, AttributeError):
        return None
    return spec


def _parse_module(module: str) -> tuple[ast.Module | None, bool]:
    """Parse the source file of a module; also return whether the module is a package."""
    spec = _find_module(module)
    if spec is None or spec.origin is None or not spec.origin.endswith(".py"):
        return None, False
    try:
        status = os.stat(spec.origin)
        tree = _parse_file(spec.origin, status.st_mtime_ns, status.st_size)
    except (OSError, SyntaxError, ValueError, RecursionError):
        tree = None
    return tree, spec.submodule_search_locations is not None


@functools.lru_cache(maxsize=1024)
def _parse_file(path: str, modified: int, size: int) -> ast.Module:
    """Parse a source file once after each modification: the files of all detectors take about a second."""
    tree = ast.parse(Path(path).read_bytes())
    waiting: list[ast.stmt] = list(tree.body)
    while waiting:
        statement = waiting.pop()
        if isinstance(statement, ast.FunctionDef | ast.AsyncFunctionDef):
            statement.body = statement.body[:1]  # its docstring, if it has one: no other statement of it is read
        else:
            waiting += getattr(statement, "body", [])
    return tree


def _resolve_import(statement: ast.ImportFrom, module: str, is_package: bool) -> str:
    """Return the full name of the module from which ``module`` imports, also for a relative import."""
    package = module if is_package else module.rpartition(".")[0]
    try:
        return resolve_name("." * statement.level + (statement.module or ""), package)
    except ImportError:
        return ""


def _find_definition(
    module: str, path: str, parse: Parse, depth: int = _REEXPORTS
) -> ast.ClassDef | ast.FunctionDef | None:
    """Find the definition of a class or function in the source of a module, or where the module imports it from."""
    tree, is_package = parse(module)
    first, _, rest = path.partition(".")
    body = tree.body if tree is not None else []
    for statement in body:
        if isinstance(statement, ast.ImportFrom) and depth:
            for alias in statement.names:
                if (alias.asname or alias.name) == first:
                    source = _resolve_import(statement, module, is_package)
                    inner = f"{alias.name}.{rest}".rstrip(".")
                    return _find_definition(source, inner, parse, depth - 1) if source else None
    found: ast.ClassDef | ast.FunctionDef | None = None
    for part in path.split("."):
        named = [node for node in body if isinstance(node, ast.ClassDef | ast.FunctionDef) and node.name == part]
        if not named:
            return None
        found, body = named[-1], named[-1].body
    return found


def _find_needs(module: str, parse: Parse) -> tuple[str, ...]:
    """Find the packages that importing a module would import beyond those that are always installed."""
    top = module.partition(".")[0]
    waiting, seen, found = [module], set[str](), set[str]()
    while waiting:
        name = waiting.pop()
        while name and name not in seen:  # importing a module imports the packages that contain it, too
            seen.add(name)
            tree, is_package = parse(name)
            for imported in _list_imports(tree.body if tree is not None else [], name, is_package):
                root = imported.partition(".")[0]
                if root == top:
                    waiting.append(imported)
                elif root and root not in _ALWAYS_INSTALLED and root not in sys.stdlib_module_names:
                    found.add(root)
            name = name.rpartition(".")[0]
    return tuple(sorted(found))


def _list_imports(body: list[ast.stmt], module: str, is_package: bool) -> Iterator[str]:
    """Yield the names that the statements of a module import when they run; those in functions are not followed."""
    for statement in body:
        if isinstance(statement, ast.Import):
            yield from (alias.name for alias in statement.names)
        elif isinstance(statement, ast.ImportFrom):
            source = _resolve_import(statement, module, is_package)
            yield source
            yield from (f"{source}.{alias.name}" for alias in statement.names)  # a name may be that of a module
        elif isinstance(statement, ast.ClassDef | ast.With | ast.Try):
            yield from _list_imports(statement.body, module, is_package)


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
    plain, given = _parse_name(name, arguments)
    factory = _find_factory(plain)
    _check_arguments(plain, factory, given)
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


def _find_factory(name: str) -> Factory:
    """Return the class or function for a name without brackets."""
    module, colon, attribute = name.partition(":")
    try:
        if name in DETECTORS:
            return DETECTORS[name]
        if colon and module and attribute:
            return DETECTORS.load(name, lambda: _import_attribute(module, attribute))
    except ArgumentError as error:
        if reason := describe_foreign_detectors():
            raise ArgumentError(f"detector {name!r} can't be loaded: {reason}") from error
        raise
    raise unknown_name("detector", name, [*DETECTORS, "module:Class"])


def _import_attribute(module: str, path: str) -> Any:
    target: Any = import_module(module)
    for part in path.split("."):
        target = getattr(target, part)
    return target


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
