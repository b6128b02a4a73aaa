"""Hash the code behind a class, a function or a name, so that a run is not resumed with other code.

The hash covers the statements that define a name, and in turn all that they use, also of other modules. Installed
distributions, Python itself and this package are left out: they have versions. Source files are read, not imported, so
an isolated run gets the hash of a detector whose code it does not load. Only what has no source file, such as a class
of a notebook, is read from its compiled code. Comments and the form of the lines do not count.
"""

from __future__ import annotations

import ast
import dis
import functools
import os
import sys
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from hashlib import sha256
from inspect import unwrap
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any

from usnet_env.definitions import find_module, resolve_import
from usnet_env.processes import is_installed

_ALL = "*"  # every name of a module
#: The packages of this distribution, whose version run.json holds.
VERSIONED = ("usnet_env", "detectors")

_LOADS = {"LOAD_GLOBAL", "LOAD_NAME", "LOAD_FROM_DICT_OR_GLOBALS"}
_STORES = {"STORE_NAME", "STORE_GLOBAL"}
_PLAIN = (type(None), bool, int, float, complex, str, bytes, tuple, list, dict, set, frozenset)


@dataclass(frozen=True)
class _Statement:
    """A statement of a module, or an object that has no source file."""

    text: str  # what it says
    binds: frozenset[str] = frozenset()  # names that it defines or changes
    loads: frozenset[str] = frozenset()  # names of the same module that it uses
    imports: tuple[tuple[str, str], ...] = ()  # names of other modules that it uses


def hash_named_code(module: str, path: str) -> str | None:
    """Hash the code behind a name of a module, without importing the module.

    Args:
        module: its full name.
        path: the name, such as ``Class`` or ``Outer.Inner``.

    Returns:
        64 hexadecimal digits; ``None`` for a module that is installed, of this package, or not found.
    """
    return _hash(_collect([(module, _root(path))]))


def hash_code(value: Any) -> str | None:
    """Hash the code behind a class with its bases, or what a function uses besides its own code.

    Returns:
        64 hexadecimal digits; ``None`` if all of it is installed or of this package.
    """
    if not isinstance(value, type):
        return _hash(_collect((value.__module__, name) for name in _global_names(value.__code__)))
    found: set[str] = set()
    for each in value.__mro__:
        own = _collect([(each.__module__, _root(each.__qualname__))])
        if not own and _is_own(each.__module__):  # of a notebook, or made by a call
            statement = _read_object(each, each.__module__)
            start = [(each.__module__, name) for name in statement.loads]
            own = {statement.text} | _collect([*start, *statement.imports])
        found |= own
    return _hash(found)


def code_text(code: CodeType) -> str:
    """What compiled code computes, as a text without addresses and line numbers."""
    return repr((code.co_code, code.co_names, [_constant_text(each) for each in code.co_consts]))


def _constant_text(constant: Any) -> str:
    if isinstance(constant, CodeType):
        return code_text(constant)
    return repr(sorted(map(repr, constant)) if isinstance(constant, frozenset) else constant)  # sets have no order


def _hash(texts: set[str]) -> str | None:
    return sha256("\n".join(sorted(texts)).encode("utf-8", "backslashreplace")).hexdigest() if texts else None


def _root(path: str) -> str:
    return path.partition(".")[0]


def _collect(starts: Iterable[tuple[str, str]]) -> set[str]:
    """The texts of all statements that define some names of modules, and what these statements use."""
    todo, seen, found = list(starts), set[tuple[str, str]](), set[str]()
    while todo:
        module, name = place = todo.pop()
        if place in seen:
            continue
        seen.add(place)
        statements = list(_find_statements(module, name))
        if not statements and name != _ALL:
            todo.append((f"{module}.{name}", _ALL))  # from package import module
        for each in statements:
            found.add(each.text)
            todo += [*((module, other) for other in each.loads), *each.imports]
    return found


def _find_statements(module: str, name: str) -> Iterator[_Statement]:
    """The statements of a module that define or change a name."""
    if not _is_own(module):
        return
    path = _find_file(module)
    if path is None:
        values = vars(sys.modules[module]) if module in sys.modules else {}
        if name in values:
            yield _read_object(values[name], module)
        return
    try:
        status = os.stat(path)
        statements = _read_file(path, module, status.st_mtime_ns, status.st_size)
    except OSError:
        return
    yield from (each for each in statements if name == _ALL or not each.binds.isdisjoint({name, _ALL}))


def _find_file(module: str) -> str | None:
    """The file of a module; ``None`` if there is none."""
    loaded = sys.modules.get(module)
    if loaded is not None:
        path = getattr(loaded, "__file__", None)
    else:
        spec = find_module(module)
        path = spec.origin if spec is not None and spec.has_location else None
    if not isinstance(path, str) or not Path(path).is_file():
        return None
    return None if module == "__main__" and is_installed(path) else path  # a notebook is run by an installed script


def _is_own(module: str) -> bool:
    """Whether a module is neither installed nor of this package."""
    first = _root(module)
    if first in VERSIONED or first in sys.stdlib_module_names:
        return False
    path = _find_file(module)
    return path is None or not is_installed(path)


@functools.lru_cache(maxsize=256)
def _read_file(path: str, module: str, modified: int, size: int) -> list[_Statement]:
    """The statements of a file; it is read once after each modification."""
    data = Path(path).read_bytes()
    try:
        body = ast.parse(data).body if path.endswith(".py") or module == "__main__" else None
    except (SyntaxError, ValueError, RecursionError):
        body = None
    if body is None:  # compiled, for example
        return [_Statement(sha256(data).hexdigest(), frozenset({_ALL}))]
    spec = getattr(sys.modules.get(module), "__spec__", None) if module == "__main__" else None
    full = spec.name if spec is not None else module
    package = full if Path(path).name == "__init__.py" else full.rpartition(".")[0]
    return [each for node in body for each in _read_node(node, package)]


def _read_node(node: ast.stmt, package: str) -> Iterator[_Statement]:
    if isinstance(node, ast.Import | ast.ImportFrom):
        for alias, imported in zip(node.names, _read_import(node, package), strict=True):
            text = f"{getattr(node, 'module', None)} {alias.name}"
            yield _Statement(text, frozenset({alias.asname or _root(alias.name)}), imports=(imported,))
        return
    code = compile(ast.Module([node], []), "", "exec", dont_inherit=True)
    inner = [each for each in ast.walk(node) if isinstance(each, ast.Import | ast.ImportFrom)]
    imports = tuple(imported for each in inner for imported in _read_import(each, package))
    binds = {each.argval for each in dis.get_instructions(code) if each.opname in _STORES} | set(_changed_names(node))
    yield _Statement(ast.unparse(node), frozenset(binds), frozenset(_global_names(code)), imports)


def _read_import(node: ast.Import | ast.ImportFrom, package: str) -> list[tuple[str, str]]:
    """What each name of an import statement stands for: a module, and a name in it or all of it."""
    if isinstance(node, ast.Import):
        return [(alias.name, _ALL) for alias in node.names]
    module = resolve_import(node, package) or node.module or ""
    return [(module, alias.name) for alias in node.names]


def _changed_names(node: ast.stmt) -> Iterator[str]:
    """Names whose objects a statement changes, as ``Class.attribute = 1`` and ``TABLE.update(a=1)`` do."""
    match node:
        case ast.Assign(targets=targets):
            changed: list[ast.expr] = list(targets)
        case ast.AugAssign(target=target) | ast.AnnAssign(target=target):
            changed = [target]
        case ast.Expr(value=ast.Call(func=ast.Attribute() as method)):
            changed = [method]
        case _:
            return
    for each in changed:
        while isinstance(each, ast.Attribute | ast.Subscript):
            each = each.value
        if isinstance(each, ast.Name):
            yield each.id


def _global_names(code: CodeType) -> set[str]:
    """The names that code looks up outside of itself."""
    names = {each.argval for each in dis.get_instructions(code) if each.opname in _LOADS}
    return names.union(*(_global_names(each) for each in code.co_consts if isinstance(each, CodeType)))


def _read_object(value: Any, module: str) -> _Statement:
    """What an object of a module without a source file says."""
    value = getattr(value, "py_func", value)  # compiled by Numba
    if isinstance(value, ModuleType):
        return _Statement(value.__name__, imports=((value.__name__, _ALL),))
    home = getattr(value, "__module__", None)
    if isinstance(value, type | FunctionType) and home != module:
        return _Statement(value.__qualname__, imports=((str(home), _root(value.__qualname__)),))
    if isinstance(value, FunctionType):
        return _Statement(code_text(value.__code__), loads=frozenset(_global_names(value.__code__)))
    if isinstance(value, type):
        members = ((name, _find_function(each)) for name, each in sorted(vars(value).items()))
        # Python adds attributes of its own, such as the number of the first line.
        own = [each for name, each in members if isinstance(each, FunctionType) or not name.startswith("__")]
        parts = [_read_object(each, module) for each in own]
        bases = tuple((base.__module__, _root(base.__qualname__)) for base in value.__bases__)
        names = frozenset().union(*(part.loads for part in parts))
        return _Statement("\n".join([value.__qualname__, *(part.text for part in parts)]), loads=names, imports=bases)
    return _Statement(_plain_text(value))


def _find_function(value: Any) -> Any:
    """The function of a method or a property; any other value as it is."""
    for name in ("func", "fget", "__func__"):  # of cached properties, properties, class and static methods
        value = getattr(value, name, value)
    return unwrap(value) if isinstance(value, FunctionType) else value


def _plain_text(value: Any) -> str:
    """The value of plain data; the type of anything else, which may change while it is used."""
    if isinstance(value, Mapping):
        return repr(sorted((repr(name), _plain_text(each)) for name, each in value.items()))
    if isinstance(value, _PLAIN):
        return repr(value) if not isinstance(value, set | frozenset) else repr(sorted(map(repr, value)))
    if hasattr(value, "tobytes") and hasattr(value, "dtype"):
        return f"{value.dtype} {sha256(value.tobytes()).hexdigest()}"
    return type(value).__qualname__
