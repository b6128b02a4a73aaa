"""The registry of named parts: one class for follow strategies, mobilities, formations, fusions, … and detectors.

A part is found by its name. It belongs to this package; or an installed distribution declares it as an entry point in
the group of its kind, such as ``usnet.follow_strategies``; or the program registers it in this process.
"""

from __future__ import annotations

import functools
import inspect
import os
import re
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from importlib.metadata import EntryPoint, entry_points
from types import MappingProxyType
from typing import Any, Generic, TypeVar

from usnet_env.config import ArgumentError, quote, suggest_name, unknown_name

OWN_DISTRIBUTION = "usnet"

PartT = TypeVar("PartT")

REGISTRIES: dict[str, Registry[Any]] = {}  # all registries of this process by the kind of their parts


class Registry(Mapping[str, PartT], Generic[PartT]):
    """The parts of one kind by name, in the order: this package, installed distributions, this process.

    An entry point is loaded when its part is looked up for the first time.

    Args:
        kind: what a part is, for sentences: ``"follow strategy"``.
        argument: the argument that selects a part by name: ``"follow"``.
        group: the group of entry points.
        home: the module that creates this registry; another process imports it to register the same parts.
        accept: checks what a program registers or an entry point names, and returns the part; called with the object
            and, for an entry point, the subject of a refusal.
        own: the parts of this package.
        reserved: further values of the argument, which no part may have as its name.
        form: a pattern that a name matches, and its description.
        classes: whether a part is a class or function that is called later; otherwise an entry point that names a
            class declares an instance of it.
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
        form: tuple[re.Pattern[str], str] = (re.compile(r".*\S.*", re.DOTALL), "be a non-empty name"),
        classes: bool = False,
    ) -> None:
        self.kind, self.argument, self.group, self.home = kind, argument, group, home
        self._accept, self._reserved, self._form, self._classes = accept, reserved, form, classes
        self._own = dict(own or {})
        self._loaded: dict[str, tuple[str, PartT]] = {}  # value of an entry point, and its part
        self._registered: dict[str, PartT] = {}
        REGISTRIES[kind] = self

    @property
    def registered(self) -> Mapping[str, PartT]:
        """The parts that were registered in this process, by name (a read-only view)."""
        return MappingProxyType(self._registered)

    def register(self, name: str, part: Any, *, replace: bool = False) -> None:
        """Register a part in this process; registering the same part again changes nothing.

        Args:
            name: a new name.
            part: the part.
            replace: whether to replace a part that was registered under this name before, as a notebook does when a
                cell is run again. The parts of this package and of installed distributions can't be replaced.

        Raises:
            ArgumentError: another part has the name, the name has another form, or the part is of another kind.
        """
        pattern, form = self._form
        if not isinstance(name, str) or not pattern.fullmatch(name) or name in self._reserved:
            other = f" other than {', '.join(map(repr, self._reserved))}" if self._reserved else ""
            raise ArgumentError(f"name must {form}{other}, got {quote(name)}.")
        if not isinstance(replace, bool):
            raise ArgumentError(f"replace must be true or false, got {quote(replace)}.")
        accepted = self._accept(part)
        if name in self._own and are_equal(self._own[name], accepted):
            return
        taken = "a name of this package" if name in self._own else f"the name of an installed {self.kind}"
        if name in self._own or (name not in self._registered and name in self.entry_points()):
            raise ArgumentError(f"name must be a new one, got {quote(name)}, which is {taken}.")
        if name in self._registered and not replace and not are_equal(self._registered[name], accepted):
            raise ArgumentError(
                f"name must be a new one, got {quote(name)}, which is registered already (replace=True replaces it)."
            )
        self._registered[name] = accepted

    def find(self, name: object) -> PartT:
        """The part of this name.

        Raises:
            ArgumentError: there is none, or its entry point can't be loaded.
        """
        if not isinstance(name, str) or name not in self:
            raise unknown_name(self.argument, name, [*self, *self._reserved])
        return self[name]

    def __getitem__(self, name: str) -> PartT:
        for parts in (self._own, self._registered):
            if name in parts:
                return parts[name]
        point = self.entry_points()[name]
        value, part = self._loaded.get(name, ("", None))
        if part is None or value != point.value:
            part = self.load(name, point.load)
            self._loaded[name] = point.value, part
        return part

    def load(self, name: str, load: Callable[[], Any]) -> PartT:
        """Import a part; whatever goes wrong is one sentence.

        Raises:
            ArgumentError: ``load`` raises an exception, or returns no part of this kind.
        """
        try:
            found = load()
            if isinstance(found, type) and not self._classes:
                found = found()
        except (Exception, SystemExit) as error:  # importing a foreign module may raise anything
            raise ArgumentError(f"{self.kind} {name!r} can't be loaded: {describe_error(error)}.") from error
        return self._accept(found, f"{self.kind} {name!r}")

    def __contains__(self, name: object) -> bool:
        return isinstance(name, str) and (name in self._own or name in self._registered or name in self.entry_points())

    def __iter__(self) -> Iterator[str]:
        return iter(dict.fromkeys([*self._own, *self.entry_points(), *self._registered]))

    def __len__(self) -> int:
        return sum(1 for _ in self)

    def entry_points(self) -> dict[str, EntryPoint]:
        """The entry points of the group by name; none of them is imported.

        The names of this package stay its own. An entry point that is malformed, or has the name of another part, is
        ignored with a warning.
        """
        found: dict[str, EntryPoint] = {}
        pattern, _ = self._form
        for point in _read_entry_points(entry_points, self.group, tuple(map(_stamp, sys.path))):
            if EntryPoint.pattern.match(point.value) is None or not pattern.fullmatch(point.name):
                written = quote(f"{point.name} = {point.value}")
                reason = f": an entry point must be written name = module:object, got {written}"
            elif point.name in self._own or point.name in self._reserved:
                reason = f", because it is a name of {OWN_DISTRIBUTION}"
            elif (taken := found.setdefault(point.name, point)).value != point.value:
                reason = f", because {_distribution_name(taken)} has a {self.kind} of the same name"
            else:
                continue
            message = f"{self.kind} {point.name!r} of {_distribution_name(point)} is ignored{reason}."
            warnings.warn(message, stacklevel=3)
        return found


@functools.lru_cache(maxsize=16)  # make_detector looks a detector up in each call, and reading a group takes 50 ms
def _read_entry_points(read: Callable[..., Iterable[EntryPoint]], group: str, places: object) -> list[EntryPoint]:
    """Read a group of entry points again if ``read`` or ``places`` is another, those of this package first."""
    points = list(read(group=group))
    return sorted(points, key=lambda point: (_distribution_name(point) != OWN_DISTRIBUTION, _distribution_name(point)))


def _stamp(folder: str) -> tuple[str, int | None]:
    """A folder of the path and when it was changed, as an installation changes it; ``None`` without one."""
    try:
        return folder, os.stat(folder or ".").st_mtime_ns
    except (OSError, ValueError):
        return folder, None


def _distribution_name(point: EntryPoint) -> str:
    try:
        name = point.dist.name if point.dist is not None else None
    except Exception:  # a partly removed distribution may have no metadata
        name = None
    return name or "an unnamed distribution"


def are_equal(one: Any, other: Any) -> bool:
    """Compare two values of any type; values whose comparison is not a single truth value are not equal."""
    try:
        return one is other or (type(one) is type(other) and bool(one == other))
    except Exception:  # the comparison of a foreign class may raise anything
        return False


def describe_error(error: BaseException) -> str:
    """Describe an exception on one line."""
    text = " ".join(str(error).split()).rstrip(".")
    return f"{type(error).__name__}: {text}" if text else type(error).__name__


def named_parameters(factory: Callable[..., Any]) -> dict[str, inspect.Parameter]:
    """Return the parameters that can be given by name; an empty dictionary if the signature can't be read."""
    try:
        parameters = inspect.signature(factory).parameters
    except (TypeError, ValueError):
        return {}
    by_name = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)
    return {name: parameter for name, parameter in parameters.items() if parameter.kind in by_name}


def check_call(subject: str, factory: Callable[..., Any], arguments: Mapping[str, Any]) -> None:
    """Refuse keyword arguments that a class or function does not take, and a call without one that it needs.

    The refusal has a subject, such as ``"detector 'random'"``.
    """
    try:
        parameter_kinds = {parameter.kind for parameter in inspect.signature(factory).parameters.values()}
    except (TypeError, ValueError):  # a class written in C may have no signature: the call then reports wrong arguments
        return
    known = named_parameters(factory)
    takes = f"it takes {', '.join(known)}" if known else "it takes no arguments"
    if inspect.Parameter.VAR_KEYWORD not in parameter_kinds:
        for argument in arguments:
            if argument not in known:
                hint = suggest_name(argument, known)
                raise ArgumentError(f"{subject} has no argument {argument!r}{hint}; {takes}.")
    for argument, parameter in known.items():
        if parameter.default is parameter.empty and argument not in arguments:
            raise ArgumentError(f"{subject} needs the argument {argument!r}; {takes}.")
