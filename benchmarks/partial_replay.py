"""Run a function again with a small change of the code, and compute anew only what the change reaches.

A :class:`Switch` changes functions or constants of a package: it edits the text of a function, or it sets a constant of
a module. Nothing is written to the package: inside ``with Replay(...)`` every module holds wrappers of its functions,
and the old functions come back afterwards.

Results of the functions in ``stored`` are kept by the content of their arguments, each with the set of switches whose
code was reached below it. A later run under a switch takes a stored result if that switch is not in the set: the code
that made it is then the same, and so is the result. All other functions run again. The functions in ``stored`` must be
pure. A function that reads a changed constant counts as reached, even if it does not use it in a particular run.
"""

from __future__ import annotations
import __future__

import inspect
import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields, is_dataclass
from hashlib import sha1
from importlib import import_module
from types import CodeType, FunctionType, ModuleType
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

__all__ = ["Edit", "Replay", "Run", "Set", "Switch", "content"]


@dataclass(frozen=True)
class Edit:
    """Replace a text of a function or property.

    Args:
        target: ``module.function`` or ``module.Class.function``, without the package.
        old: a text that occurs exactly once in its source.
        new: the text that replaces it.
    """

    target: str
    old: str
    new: str


@dataclass(frozen=True)
class Set:
    """Set a constant of a module.

    Args:
        target: ``module.NAME``, without the package; the module is one that reads the constant.
        value: the value.
    """

    target: str
    value: Any


@dataclass(frozen=True)
class Switch:
    """One rule that can be switched off.

    Args:
        key: a short name.
        group: which part of the detector it belongs to.
        what: one line: what is switched off, and what is done instead.
        changes: what to change.
        second: whether it is on the second list, since its replays take long.
    """

    key: str
    group: str
    what: str
    changes: tuple[Edit | Set, ...]
    second: bool = False


@dataclass(frozen=True)
class Run:
    """A result, the keys of the switches whose code was reached, and whether a stored result came out differently."""

    result: Any
    reached: frozenset[str]
    changed: bool


@dataclass
class _Entry:
    result: Any
    reached: frozenset[str]
    unchanged: bool  # part of a run without a switch


_PLAIN = frozenset({type(None), bool, int, float, str, bytes, slice})
_known: WeakKeyDictionary[Any, bytes] = WeakKeyDictionary()


def content(value: Any) -> bytes:
    """A digest of the content of arrays, dataclasses, containers and plain values."""
    kind = type(value)
    if kind is np.ndarray:
        data = value if value.flags.c_contiguous else np.ascontiguousarray(value)
        return (
            sha1(data.data if data.size else b"", usedforsecurity=False).digest()
            + repr((data.shape, data.dtype.str)).encode()
        )
    if kind in _PLAIN or isinstance(value, np.generic):
        return repr((kind.__name__, value)).encode()
    if kind is tuple or kind is list:
        return sha1(b"|".join([b"%d" % len(value), *map(content, value)]), usedforsecurity=False).digest()
    if isinstance(value, Mapping):
        return content([part for pair in value.items() for part in pair])
    if not is_dataclass(kind):
        raise TypeError(f"content of {kind.__name__} is not defined.")
    by_identity = kind.__hash__ is object.__hash__
    if by_identity and (known := _known.get(value)) is not None:
        return known
    parts = [kind.__name__.encode(), *(content(getattr(value, field.name)) for field in fields(value))]
    found = sha1(b"|".join(parts), usedforsecurity=False).digest()
    if by_identity:
        _known[value] = found
    return found


class Replay:
    """Runs functions of a package, whole or under one switch.

    Args:
        package: name of the package.
        modules: names of its modules, in which functions are wrapped.
        switches: the switches, with different keys.
        stored: ``module.function`` whose results are kept.
        names: further values that the texts of edits may use, by name.
    """

    def __init__(
        self,
        package: str,
        modules: Sequence[str],
        switches: Sequence[Switch],
        stored: Sequence[str],
        names: Mapping[str, Any] | None = None,
    ) -> None:
        self._names = dict(names or {})
        self.switches = {switch.key: switch for switch in switches}
        if len(self.switches) != len(switches):
            raise ValueError("every switch must have a key of its own.")
        # A module that several detectors share lies beside the package.
        beside = {"policy": f"{package.rpartition('.')[0]}.policy"}
        self._modules = {name: import_module(beside.get(name, f"{package}.{name}")) for name in modules}
        self._stored = frozenset(stored)
        self._old: list[tuple[Any, str, Any]] = []
        self._frames: list[set[str]] = []
        self._current: str | None = None
        self._changed = False
        self._plain: dict[tuple[str, bytes], _Entry] = {}
        self._own: dict[tuple[str, bytes], _Entry] = {}

    def __enter__(self) -> Replay:
        """Put the wrappers in place."""
        readers: dict[str, dict[str, set[str]]] = {name: {} for name in self._modules}
        edits: dict[str, dict[str, list[Edit]]] = {}
        for switch in self.switches.values():
            for change in switch.changes:
                if isinstance(change, Edit):
                    edits.setdefault(change.target, {}).setdefault(switch.key, []).append(change)
                else:
                    module, name = change.target.split(".")
                    if not hasattr(self._modules[module], name):
                        raise ValueError(f"{change.target} does not exist.")
                    readers[module].setdefault(name, set()).add(switch.key)
        wrapped: dict[int, Any] = {}
        found = set()
        for name, module in self._modules.items():
            for holder, attribute, function in _functions(module):
                path = f"{name}.{attribute}" if holder is module else f"{name}.{holder.__name__}.{attribute}"
                found.add(path)
                plain = function.fget if isinstance(function, property) else function
                reads = readers[name].keys() & _names(plain.__code__)
                reached = {key for constant in reads for key in readers[name][constant]} | edits.get(path, {}).keys()
                variants = {
                    key: _edited(module, function, own, self._names) for key, own in edits.get(path, {}).items()
                }
                if not reached and path not in self._stored:
                    continue
                wrapper = self._wrapper(path, plain, variants, frozenset(reached))
                if holder is module:
                    wrapped[id(function)] = wrapper
                else:
                    self._set(holder, attribute, property(wrapper) if isinstance(function, property) else wrapper)
        if missing := (edits.keys() | self._stored) - found:
            raise ValueError(f"no such function: {', '.join(sorted(missing))}.")
        for module in self._modules.values():
            for attribute, value in list(vars(module).items()):
                if isinstance(value, FunctionType) and id(value) in wrapped:
                    self._set(module, attribute, wrapped[id(value)])
        return self

    def __exit__(self, *_: object) -> None:
        """Put the old functions back."""
        while self._old:
            holder, name, value = self._old.pop()
            setattr(holder, name, value)
        self.forget()

    def forget(self) -> None:
        """Drop all stored results."""
        self._plain.clear()
        self._own.clear()

    def run(self, call: Callable[[], Any], switch: str | None = None) -> Run:
        """Call a function, whole or under a switch.

        Raises:
            Exception: what the call raises.
        """
        if switch != self._current:
            self._own.clear()
        self._changed, frame = False, set[str]()
        self._frames = [frame]
        with self._applied(switch):
            result = call()
        return Run(result, frozenset(frame), self._changed)

    @contextmanager
    def _applied(self, switch: str | None) -> Iterator[None]:
        self._current = switch
        constants = [] if switch is None else [c for c in self.switches[switch].changes if isinstance(c, Set)]
        places = [(self._modules[c.target.split(".")[0]], c.target.split(".")[1], c.value) for c in constants]
        old = [(module, name, getattr(module, name)) for module, name, _ in places]
        try:
            for module, name, value in places:
                setattr(module, name, value)
            yield
        finally:
            for module, name, value in reversed(old):
                setattr(module, name, value)

    def _set(self, holder: Any, name: str, value: Any) -> None:
        self._old.append((holder, name, vars(holder)[name]))
        setattr(holder, name, value)

    def _wrapper(
        self, path: str, function: Callable[..., Any], variants: dict[str, Any], reached: frozenset[str]
    ) -> Callable[..., Any]:
        def direct(*args: Any, **kwargs: Any) -> Any:
            self._frames[-1].update(reached)
            return variants.get(self._current or "", function)(*args, **kwargs)

        def stored(*args: Any, **kwargs: Any) -> Any:
            key = path, content([args, kwargs])
            current = self._current
            entry = self._plain.get(key)
            if entry is not None and (current is None or current not in entry.reached):
                self._changed |= not entry.unchanged
                self._frames[-1].update(entry.reached)
                return entry.result
            if (own := self._own.get(key)) is not None:
                self._frames[-1].update(own.reached)
                return own.result
            frame: set[str] = set()
            self._frames.append(frame)
            try:
                result = direct(*args, **kwargs)
            finally:
                self._frames.pop()
                self._frames[-1].update(frame)
            if current is None or current not in frame:
                self._changed |= current is not None
                self._plain[key] = _Entry(result, frozenset(frame), current is None)
                return result
            if entry is None or content(result) != content(entry.result):
                self._changed = True
            else:
                result = entry.result
            self._own[key] = _Entry(result, frozenset(frame), False)
            return result

        return stored if path in self._stored else direct


def _functions(module: ModuleType) -> Iterator[tuple[Any, str, Any]]:
    """Holder, name and value of every function that a module defines, and of the methods and properties of classes."""
    for name, value in list(vars(module).items()):
        if isinstance(value, FunctionType) and value.__module__ == module.__name__:
            yield module, name, value
        elif isinstance(value, type) and value.__module__ == module.__name__:
            for attribute, method in list(vars(value).items()):
                plain = method.fget if isinstance(method, property) else method
                if isinstance(plain, FunctionType) and not attribute.startswith("__"):
                    yield value, attribute, method


def _names(code: CodeType) -> set[str]:
    """The global names that a function reads, those of its inner functions included."""
    inner = (_names(constant) for constant in code.co_consts if isinstance(constant, CodeType))
    return set(code.co_names).union(*inner)


def _edited(module: ModuleType, function: Any, edits: Sequence[Edit], names: Mapping[str, Any]) -> Any:
    """The function with edits of its text; it reads the same module, and ``names``."""
    plain = function.fget if isinstance(function, property) else function
    source = textwrap.dedent(inspect.getsource(plain))
    for edit in edits:
        if source.count(edit.old) != 1:
            raise ValueError(f"{edit.target} must hold {edit.old!r} exactly once, got {source.count(edit.old)}.")
        source = source.replace(edit.old, edit.new)
    body = textwrap.indent(source, "    ")
    whole = f"def _made({', '.join(names)}):\n{body}\n    return {plain.__name__}\n"
    space: dict[str, Any] = {}
    code = compile(whole, f"<{module.__name__}, edited>", "exec", flags=__future__.annotations.compiler_flag)
    exec(code, module.__dict__, space)
    made = space["_made"](**names)
    return made.fget if isinstance(made, property) else made
