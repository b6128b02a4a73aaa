"""Commands of ``usnet`` that other packages add by entry points of the group ``usnet.commands``."""

from __future__ import annotations

import tomllib
import warnings
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any

import click

GROUP = "usnet.commands"
_OWN_DISTRIBUTION = "usnet"


@cache
def find_entry_points(group: str) -> dict[str, EntryPoint]:
    """Find the entry points of a group by name; those of this package come first."""
    installed = sorted(
        entry_points(group=group), key=lambda point: getattr(point.dist, "name", "") != _OWN_DISTRIBUTION
    )
    found = _read_source_tree(group)
    for point in installed:
        found.setdefault(point.name, point)
    return found


def _read_source_tree(group: str) -> dict[str, EntryPoint]:
    """Read the entry points of a source tree, which may be newer than its installation, or not be installed."""
    try:
        project = tomllib.loads(Path(__file__).parents[2].joinpath("pyproject.toml").read_text("utf-8"))["project"]
        points = project["entry-points"][group] if project["name"] == _OWN_DISTRIBUTION else {}
    except (OSError, ValueError, KeyError):  # the installation of a wheel has no such file
        return {}
    return {name: EntryPoint(name, value, group) for name, value in points.items()}


class CommandGroup(click.Group):
    """A group that also has the commands of :func:`find_entry_points`; each is imported when it is used or listed."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """List the names of all commands; one that cannot be imported is left out with a warning."""
        return sorted({*self.commands, *(name for name in find_entry_points(GROUP) if self._can_be_loaded(ctx, name))})

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Return the command of this name, which is imported if another package has it."""
        if cmd_name not in self.commands and cmd_name in find_entry_points(GROUP):
            loaded: Any = find_entry_points(GROUP)[cmd_name].load()
            if not isinstance(loaded, click.Command):
                raise TypeError(f"the entry point {cmd_name!r} of {GROUP} must be a click.Command")
            self.add_command(loaded, cmd_name)
        return super().get_command(ctx, cmd_name)

    def _can_be_loaded(self, ctx: click.Context, name: str) -> bool:
        try:
            return self.get_command(ctx, name) is not None
        except Exception as error:  # importing a foreign module may raise anything
            warnings.warn(f"command {name!r} cannot be used: {type(error).__name__}: {error}", stacklevel=2)
            return False
