"""Named parts: follow strategies, mobilities, formations, … and detectors.

A part is found by its name. It belongs to this package; or an installed distribution declares it as an entry point in
the group of its kind, such as ``usnet.follow_strategies``; or the program registers it in this process. A label, such
as ``lagged-regression(clusters=5)``, is a name with arguments.
"""

from __future__ import annotations

import ast
import inspect
import re
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from types import FunctionType
from typing import Any, Generic, TypeVar

from usnet_env.config import ArgumentError, missing_extra, quote, unknown_argument, unknown_name

PartT = TypeVar("PartT")

REGISTRIES: dict[str, Registry[Any]] = {}  # all registries of this process by the kind of their parts
_NAME = re.compile(r"\w[\w.-]*")
_MAX_ERROR_LENGTH = 300  # characters


@cache
def find_entry_points(group: str) -> dict[str, EntryPoint]:
    """The entry points of a group by name, read once; of two with one name, that of this package."""
    points = sorted(entry_points(group=group), key=lambda point: point.dist is not None and point.dist.name == "usnet")
    return {point.name: point for point in points}


class Registry(Mapping[str, PartT], Generic[PartT]):
    """The parts of one kind by name, in the order: this package, installed distributions, this process.

    Args:
        kind: what a part is, for sentences: ``"follow strategy"``.
        argument: the argument that selects a part by name: ``"follow"``.
        group: the group of entry points; one is loaded when its part is looked up for the first time.
        home: the module that creates this registry; another process imports it to register the same parts.
        accept: checks an object, with the subject of a refusal, and returns the part.
        own: the parts of this package.
        reserved: further values of the argument, which no part may have as its name.
        classes: whether parts are classes or functions; otherwise an entry point of a class declares an instance.
    """

    def __init__(
        self,
        kind: str,
        argument: str,
        group: str,
        home: str,
        accept: Callable[..., PartT],
        own: Mapping[str, PartT] | None = None,
        *,
        reserved: tuple[str, ...] = (),
        classes: bool = False,
    ) -> None:
        self.kind, self.argument, self.group, self.home = kind, argument, group, home
        self.registered: dict[str, PartT] = {}
        self._accept, self._reserved, self._classes = accept, reserved, classes
        self._own = dict(own or {})
        self._loaded: dict[str, PartT] = {}
        REGISTRIES[kind] = self

    def register(self, name: str, part: Any, *, replace: bool = False) -> None:
        """Register a part in this process; registering the same part again changes nothing.

        Args:
            name: a new name of letters, digits, ``_``, ``.`` and ``-``.
            part: the part.
            replace: whether to replace a part that was registered under this name before, as a notebook does when a
                cell is run again. The parts of this package and of installed distributions can't be replaced.

        Raises:
            ArgumentError: another part has the name, the name has another form, or the part is of another kind.
        """
        if not isinstance(name, str) or not _NAME.fullmatch(name) or name in self._reserved:
            raise ArgumentError(f"name must consist of letters, digits, '_', '.' and '-', got {quote(name)}.")
        accepted = self._accept(part, self.kind)
        is_fixed = name in self._own or name in self.entry_points()
        present = self[name] if is_fixed or (name in self.registered and not replace) else accepted
        if not are_equal(present, accepted):
            other = f"the name of an installed {self.kind}"
            hint = other if is_fixed else "registered already (replace=True replaces it)"
            raise ArgumentError(f"name must be a new one, got {name!r}, which is {hint}.")
        if not is_fixed:
            self.registered[name] = accepted

    def find(self, name: object) -> PartT:
        """The part of this name; :class:`ArgumentError` without it, or if it can't be loaded."""
        if not isinstance(name, str) or name not in self:
            raise unknown_name(self.argument, name, [*self, *self._reserved])
        return self[name]

    def load(self, name: str, load: Callable[[], Any]) -> PartT:
        """Import a part; whatever goes wrong is one sentence, as for :meth:`find`."""
        subject = f"{self.kind} {name!r}"
        try:
            part = load()
            part = part() if isinstance(part, type) and not self._classes else part
        except (Exception, SystemExit) as error:  # importing a foreign module may raise anything
            missing_error = missing_extra(subject, error)
            raise missing_error or ArgumentError(f"{subject} can't be loaded: {describe_error(error)}.") from error
        return self._accept(part, subject)

    def name_of(self, part: PartT) -> str:
        """The name of a part in quotes, or that of its class if it has none."""
        known = {**self._own, **self._loaded, **self.registered}
        return next((repr(name) for name, other in known.items() if other is part), type(part).__name__)

    def entry_points(self) -> dict[str, EntryPoint]:
        """The entry points of the group by name; none of them is imported. The names of this package stay its own."""
        reserved = (*self._own, *self._reserved)
        return {name: point for name, point in find_entry_points(self.group).items() if name not in reserved}

    def __getitem__(self, name: str) -> PartT:
        if name in self._own:
            return self._own[name]
        if name in self.registered:
            return self.registered[name]
        if name not in self._loaded:
            self._loaded[name] = self.load(name, self.entry_points()[name].load)
        return self._loaded[name]

    def __iter__(self) -> Iterator[str]:
        return iter(dict.fromkeys([*self._own, *self.entry_points(), *self.registered]))

    def __contains__(self, name: object) -> bool:  # without loading it
        return name in self._own or name in self.registered or name in self.entry_points()

    def __len__(self) -> int:
        return len(list(iter(self)))


def are_equal(one: Any, other: Any) -> bool:
    """Compare two values of any type; values whose comparison is not a single truth value are not equal."""
    try:
        return one is other or (type(one) is type(other) and bool(one == other))
    except ValueError:  # of arrays
        return False


def check_factory(factory: Any, subject: str) -> Callable[..., Any]:
    """Accept a class or a function for a registry of parts that are made by calls."""
    if not callable(factory):
        raise ArgumentError(f"{subject} must be a class or a function, got {quote(factory)}.")
    return factory


def accept_objects(kind: type, wrap: Callable[[Any], Any] | None = None) -> Callable[..., Any]:
    """What accepts objects of a class for a registry, and functions if ``wrap`` makes such an object of one."""

    def accept(part: Any, subject: str) -> Any:
        if isinstance(part, kind):
            return part
        if wrap is None or not callable(part):
            expected = f"{kind.__name__} or a function" if wrap else kind.__name__
            raise ArgumentError(f"{subject} must be a {expected}, got {quote(part)}.")
        return wrap(part)

    return accept


def describe_error(error: BaseException) -> str:
    """Describe an exception on one line of some hundred characters."""
    text = " ".join(str(error).split()).rstrip(".")
    text = text if len(text) <= _MAX_ERROR_LENGTH else f"{text[:_MAX_ERROR_LENGTH]}…"
    return f"{type(error).__name__}: {text}" if text else type(error).__name__


def named_parameters(factory: Callable[..., Any]) -> dict[str, inspect.Parameter]:
    """The parameters that can be given by name."""
    kinds = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)
    parameters = inspect.signature(factory).parameters.items()
    return {name: parameter for name, parameter in parameters if parameter.kind in kinds}


def check_call(subject: str, factory: Callable[..., Any], arguments: Mapping[str, Any]) -> None:
    """Refuse keyword arguments that ``subject``, as ``"detector 'random'"``, does not take, and a call without one."""
    try:
        inspect.signature(factory).bind(**arguments)
    except TypeError as error:
        known = named_parameters(factory)
        for name in arguments.keys() - known.keys():
            raise unknown_argument(name, subject, known) from None
        raise ArgumentError(f"{subject} is {error}; it takes {', '.join(known)}.") from None


def format_label(name: str, arguments: Mapping[str, Any]) -> str:
    """Format a name and arguments; without arguments, the name alone."""
    texts = ", ".join(f"{key}={_format_value(arguments[key])}" for key in sorted(arguments))
    return f"{name}({texts})" if texts else name


def _format_value(value: Any) -> str:
    if isinstance(value, FunctionType):
        return value.__qualname__  # its repr has an address, which differs from run to run
    return repr(value) if isinstance(value, str | bytes | list | tuple | set | dict) else " ".join(repr(value).split())


def parse_label(text: Any, further_arguments: Mapping[str, Any]) -> tuple[str, dict[str, Any]]:
    """Parse ``name(key=literal, ...)`` into the name and its arguments, and add further arguments."""
    if not isinstance(text, str) or not text.strip():
        raise ArgumentError(f"detector must be a name, got {quote(text)}.")
    name, bracket, inner = text.strip().partition("(")
    arguments = _parse_arguments(text, inner) if bracket else {}
    if repeated := arguments.keys() & further_arguments.keys():
        raise ArgumentError(f"{min(repeated)} must be given once, got it in {quote(text)} and as a further argument.")
    return name.strip(), {**arguments, **further_arguments}


def _parse_arguments(text: str, inner: str) -> dict[str, Any]:
    """Parse the arguments in ``inner``, the part of ``text`` after the opening bracket; this runs no code."""
    try:
        match ast.parse(f"name({inner}", mode="eval").body:
            case ast.Call(func=ast.Name(), args=[], keywords=keywords):
                arguments = {keyword.arg or "**": ast.literal_eval(keyword.value) for keyword in keywords}
                if "**" not in arguments and len(arguments) == len(keywords):
                    return arguments
    except (SyntaxError, ValueError, TypeError, MemoryError, RecursionError):
        pass
    form = "name(argument=value, ...) with Python literals as values"
    raise ArgumentError(f"detector must be written {form}, got {quote(text)}.")
