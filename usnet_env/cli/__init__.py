"""The command line: ``usnet evaluate``, ``demo``, ``replay``, ``detect``, ``list``, and the commands of other packages.

``train`` and ``check-detector`` belong to the package ``detectors``, and are found by their entry points. Every refusal
or failure is one sentence on standard error, without a traceback. Each command imports its heavy modules itself, so
that ``usnet --help`` is fast.
"""

from __future__ import annotations

import io
import os
import signal
import sys
import traceback
import warnings
from collections.abc import Sequence
from typing import Any

import click
from click.shell_completion import shell_complete

from usnet_env import compiling
from usnet_env.cli.detect import detect
from usnet_env.cli.evaluation import evaluate, report
from usnet_env.cli.list_parts import list_
from usnet_env.cli.output import print_message
from usnet_env.cli.replay import demo, replay
from usnet_env.config import ArgumentError, MissingExtraError, missing_extra
from usnet_env.parts import describe_error, find_entry_points

__all__ = ["main"]

GROUP = "usnet.commands"  # of entry points
_REFUSED, _FAILED, _INTERRUPTED = 2, 1, 130


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


@click.group(cls=CommandGroup, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(package_name="usnet", prog_name="usnet", message="%(prog)s %(version)s")
def _usnet() -> None:
    """Simulate UAV swarms, find their cluster heads with detectors, and score the detectors."""


for _command in (evaluate, demo, detect, list_, replay, report):
    _usnet.add_command(_command)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line with arguments ``argv``, by default those of this process, and return its exit status.

    It is 0 for success, 1 for a failure, 2 if an argument was refused or a detector failed, 130 after an interruption.
    """
    context: click.Context | None = None
    try:
        _prepare_process()
        if request := os.environ.get("_USNET_COMPLETE"):  # a shell asks for a script, or for words that may follow
            return shell_complete(_usnet, {}, "usnet", "_USNET_COMPLETE", request)
        if sys.stderr is not None and sys.stderr.isatty():
            compiling.tell_if_long(print_message)
        with _usnet.make_context("usnet", list(sys.argv[1:] if argv is None else argv)) as context:
            _usnet.invoke(context)
            sys.stdout.flush()
        return 0
    except KeyboardInterrupt:
        if argv is None:  # this process ends now: a second Ctrl-C must not break the sentence
            signal.signal(signal.SIGINT, signal.SIG_IGN)
        print_message(f"interrupted. {(context and context.obj) or ''}".rstrip())
        return _INTERRUPTED
    except click.exceptions.Exit as end:
        return int(end.exit_code)
    except click.exceptions.NoArgsIsHelpError as error:
        click.echo(error.format_message(), err=True)
        return _REFUSED
    except click.ClickException as error:
        sentence = " ".join(error.format_message().split()).rstrip(".")
        print_message(sentence if sentence.endswith("?") else f"{sentence}.")
        return _REFUSED
    except (ArgumentError, MissingExtraError) as error:
        print_message(str(error))
        return _REFUSED
    except (SystemExit, BrokenPipeError) as end:
        if isinstance(end, SystemExit) and not isinstance(end.__context__, BrokenPipeError):  # Rich exits after one
            print_message(f"ended by sys.exit({end.code!r}) in a detector or another plug-in.")
        else:  # the program that reads our output has ended, for example `head`
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return _FAILED
    except Exception as error:
        return _report_failure(error)


def _prepare_process() -> None:
    """Print "?" for what a terminal can't show, and find modules of the current folder after installed ones."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")
    if "" not in sys.path and os.getcwd() not in sys.path:
        sys.path.append(os.getcwd())  # `module:Class` is often there


def _report_failure(error: Exception) -> int:
    """Report a failed detector, a file that cannot be used, too little memory, or an unexpected error."""
    if os.environ.get("USNET_TRACEBACK"):
        traceback.print_exception(error)
    if type(error).__name__ == "EvaluationError":  # compared by name, because its module is slow to import
        print_message(str(error))
        return _REFUSED
    sentence = f"failed with {describe_error(error)}. USNET_TRACEBACK=1 shows where."
    if isinstance(error, OSError) and error.strerror:
        sentence = f"cannot use {error.filename or 'a file'}: {error.strerror}."
    elif isinstance(error, MemoryError):
        sentence = "not enough memory; try fewer UAVs, observation steps or workers."
    print_message(str(missing_extra("this command", error) or sentence))
    return _FAILED
