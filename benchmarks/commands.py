"""The commands that make every committed file of benchmarks/results, as ``benchmarks/README.md`` lists them.

A test holds the arguments of the commands against what the files record of themselves.
"""

from __future__ import annotations

import re
from pathlib import Path

_ENTRY = re.compile(r"^\*\*[^\n]+\*\*: (`[^\n]+`)\n\n```shell\n(.*?)^```$", re.MULTILINE | re.DOTALL)

#: The commands of each entry, in any order, by its files: paths below benchmarks/results; a folder ends in ``/``.
COMMANDS: dict[tuple[str, ...], tuple[str, ...]] = {
    tuple(re.findall("`(.+?)`", files)): tuple(commands.splitlines())
    for files, commands in _ENTRY.findall(Path(__file__).with_name("README.md").read_text(encoding="utf-8"))
}


def commands_of(name: str) -> tuple[str, ...]:
    """The commands that make a file or folder below benchmarks/results; none if it has no entry."""
    return tuple(command for files, commands in COMMANDS.items() if name in files for command in commands)
