"""Turn docstrings in Google's style into Markdown that can be read with and without Sphinx."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from textwrap import dedent, indent

__all__ = ["describe_class"]

_SECTION = re.compile(r"^(Args|Raises):\n((?:(?: {4}.*)?\n)*)", re.MULTILINE)
_ENTRY = re.compile(r"^(\w+(?:, \w+)*): ", re.MULTILINE)
_ROLE = re.compile(r":(\w+):`~?([\w.]+)`")


def describe_class(described: type) -> str:
    """Markdown of what a class does and takes: its docstring without the first line; arguments have their defaults.

    An argument that the docstring leaves out is described by that of a base class; so are the errors.

    Raises:
        ValueError: an argument of the constructor is described nowhere.
    """
    text = inspect.getdoc(described) or ""
    about = _SECTION.sub("", text.partition("\n")[2] + "\n").strip()
    parameters = inspect.signature(described).parameters
    entries = _find_entries(described, set(parameters))
    lines = []
    for names, meaning in entries.items():
        shown = ", ".join(f"`{name}={parameters[name].default!r}`" for name in names)
        lines.append(f"* {shown}: {indent(meaning, '  ').lstrip()}")
    raised = (list(_read_entries(inspect.cleandoc(base.__doc__ or ""), "Raises")) for base in inspect.getmro(described))
    errors = [f"Raises `{name}` {meaning}" for (name,), meaning in next(filter(None, raised), [])]
    parts = [about, "## Arguments", "\n".join(lines) or "It takes no arguments.", *errors]
    return _to_markdown("\n\n".join(part for part in parts if part))


def _find_entries(described: type, names: set[str]) -> dict[tuple[str, ...], str]:
    """What is said about each argument, in the order of the docstrings."""
    found: dict[tuple[str, ...], str] = {}
    for base in inspect.getmro(described):
        for own, meaning in _read_entries(inspect.cleandoc(base.__doc__ or ""), "Args"):
            if set(own) <= names:
                found[own] = meaning
                names = names - set(own)
    if names:
        raise ValueError(f"{described.__name__} must describe its arguments, got nothing about {sorted(names)}.")
    return found


def _read_entries(text: str, section: str) -> Iterator[tuple[tuple[str, ...], str]]:
    """The entries of a section: the names before the colon, and the text after it."""
    for match in _SECTION.finditer(text + "\n"):
        if match[1] == section:
            _, *parts = _ENTRY.split(dedent(match[2]))
            for names, meaning in zip(parts[::2], parts[1::2], strict=True):
                first, _, rest = meaning.partition("\n")
                yield tuple(names.split(", ")), f"{first}\n{dedent(rest)}".strip()


def _to_markdown(text: str) -> str:
    """Roles and literals of reStructuredText in the form of Markdown; a name without a module is no link."""
    text = _ROLE.sub(lambda role: f"{{{role[1]}}}`{role[2]}`" if "." in role[2] else f"`{role[2]}`", text)
    return text.replace("``", "`")
