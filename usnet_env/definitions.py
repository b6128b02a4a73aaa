"""Read the definition of a class from source files, without importing anything."""

from __future__ import annotations

import ast
import functools
import os
from dataclasses import dataclass
from importlib.machinery import ModuleSpec, PathFinder
from importlib.util import find_spec, resolve_name
from pathlib import Path
from typing import Any

_STEPS = 8  # limit of the chain of re-exports, and of the chain of base classes


@dataclass(frozen=True)
class Definition:
    """A class or function in a source file."""

    module: str  # that defines it
    node: ast.ClassDef | ast.FunctionDef

    @property
    def docstring(self) -> str:
        """The docstring, or an empty text."""
        return ast.get_docstring(self.node) or ""

    def read_call(self, attribute: str, steps: int = _STEPS) -> dict[str, Any]:
        """The literal keyword arguments of the call that a class, or else its nearest base, assigns to an attribute.

        Returns:
            ``{"a": 1}`` for ``attribute = Something(a=1)``; empty if there is no such assignment.
        """
        for statement in self.node.body:
            match statement:
                case (
                    ast.Assign(targets=[ast.Name(id=name)], value=ast.Call(keywords=keywords))
                    | ast.AnnAssign(target=ast.Name(id=name), value=ast.Call(keywords=keywords))
                ) if name == attribute:
                    try:
                        return {str(each.arg): ast.literal_eval(each.value) for each in keywords}
                    except ValueError:
                        return {}
        for base in self.node.bases if isinstance(self.node, ast.ClassDef) and steps else ():
            found = find_definition(self.module, ast.unparse(base))
            if found is not None and (values := found.read_call(attribute, steps - 1)):
                return values
        return {}


def find_definition(module: str, path: str, steps: int = _STEPS) -> Definition | None:
    """Find the definition of a class or function in a module, or where the module imports it from.

    Args:
        module: the full name of the module.
        path: the name in the module, such as ``Outer.Inner``.
        steps: how many re-exports are followed.
    """
    tree, is_package = _parse_module(module)
    first, _, rest = path.partition(".")
    body = tree.body if tree is not None else []
    for statement in body:
        if isinstance(statement, ast.ImportFrom) and steps:
            for alias in statement.names:
                if (alias.asname or alias.name) == first:
                    source = resolve_import(statement, module if is_package else module.rpartition(".")[0])
                    inner = f"{alias.name}.{rest}".rstrip(".")
                    return find_definition(source, inner, steps - 1) if source else None
    found: ast.ClassDef | ast.FunctionDef | None = None
    for part in path.split("."):
        named = [node for node in body if isinstance(node, ast.ClassDef | ast.FunctionDef) and node.name == part]
        if not named:
            return None
        found, body = named[-1], named[-1].body
    return Definition(module, found) if found is not None else None


def find_module(module: str) -> ModuleSpec | None:
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
    spec = find_module(module)
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
    """Parse a source file once after each modification."""
    return ast.parse(Path(path).read_bytes())


def resolve_import(statement: ast.ImportFrom, package: str) -> str:
    """The full name of the module from which a module of a package imports; empty if a relative import leaves it."""
    try:
        return resolve_name("." * statement.level + (statement.module or ""), package)
    except ImportError:
        return ""
