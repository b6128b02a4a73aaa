"""Commands of ``usnet`` that other packages add by entry points of the group ``usnet.commands``."""

from __future__ import annotations

import warnings
from typing import Any

import click

from usnet_env.parts import describe_error, find_entry_points

GROUP = "usnet.commands"


class CommandGroup(click.Group):
    """A group that also has the commands of entry points; each is imported when it is used or listed."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """List all commands, without those that can't be imported."""
        names = set(self.commands)
        for name in find_entry_points(GROUP):
            try:
                self.get_command(ctx, name)
                names.add(name)
            except Exception as error:  # importing a foreign module may raise anything
                warnings.warn(f"command {name!r} cannot be used: {describe_error(error)}", stacklevel=2)
        return sorted(names)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Return the command of this name, which is imported if another package has it."""
        if cmd_name not in self.commands and cmd_name in find_entry_points(GROUP):
            loaded: Any = find_entry_points(GROUP)[cmd_name].load()
            if not isinstance(loaded, click.Command):
                raise TypeError(f"the entry point {cmd_name!r} of {GROUP} must be a click.Command")
            self.add_command(loaded, cmd_name)
        return super().get_command(ctx, cmd_name)
