"""The command line: ``usnet evaluate``, ``demo``, ``reproduce``, ``train``, ``check-detector`` and ``list``.

No traceback reaches the user: whatever is refused or fails is one sentence on standard error. Everything heavy is
imported by the command that needs it, so that ``usnet --help`` answers at once.
"""

from __future__ import annotations

import os
import sys
import traceback
from collections.abc import Sequence

import click

from usnet_env.cli.inspection import check_detector, list_
from usnet_env.cli.play import demo, evaluate
from usnet_env.cli.reproduce import reproduce
from usnet_env.cli.train import train
from usnet_env.cli.words import say
from usnet_env.config import ArgumentError

__all__ = ["main"]

_REFUSED, _FAILED, _INTERRUPTED = 2, 1, 130


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(package_name="usnet", prog_name="usnet", message="%(prog)s %(version)s")
def _usnet() -> None:
    """Who leads this swarm? Environments, a referee and detectors for finding the cluster heads of a UAV swarm."""


for _command in (evaluate, demo, reproduce, train, check_detector, list_):
    _usnet.add_command(_command)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line.

    Args:
        argv: the words after ``usnet``; by default those of this process.

    Returns:
        The exit status: 0, 1 if something failed, 2 if an argument was refused or a detector failed, 130 if it was
        interrupted.
    """
    if "" not in sys.path and os.getcwd() not in sys.path:
        sys.path.insert(0, os.getcwd())  # a console script does not look there, but module:Class often lies there
    try:
        with _usnet.make_context("usnet", list(sys.argv[1:] if argv is None else argv)) as context:
            try:
                _usnet.invoke(context)
                sys.stdout.flush()
            except (KeyboardInterrupt, EOFError):
                say(f"interrupted. {context.obj or ''}".rstrip())
                return _INTERRUPTED
        return 0
    except click.exceptions.Exit as end:
        return int(end.exit_code)
    except click.exceptions.NoArgsIsHelpError as error:
        click.echo(error.format_message(), err=True)
        return _REFUSED
    except click.ClickException as error:
        say(" ".join(error.format_message().split()).rstrip(".") + ".")
        return _REFUSED
    except KeyboardInterrupt:
        say("interrupted.")
        return _INTERRUPTED
    except BrokenPipeError:  # the reader of our output has gone, as `head` does
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return _FAILED
    except ArgumentError as error:
        say(str(error))
        return _REFUSED
    except Exception as error:
        return _failed(error)


def _failed(error: Exception) -> int:
    """What is left: a detector that failed, files that cannot be written, and what should not happen at all."""
    if os.environ.get("USNET_TRACEBACK"):
        traceback.print_exception(error)
    if type(error).__name__ == "EvaluationError":  # by name: its module is heavy, and may not have been imported
        say(str(error))
        return _REFUSED
    if isinstance(error, OSError) and error.strerror:
        say(f"cannot use {error.filename or 'a file'}: {error.strerror}.")
        return _FAILED
    if isinstance(error, MemoryError):
        say("there is not enough memory for this; try fewer UAVs, observation steps or workers.")
        return _FAILED
    text = " ".join(str(error).split())
    say(f"failed with {type(error).__name__}: {text.rstrip('.')}. USNET_TRACEBACK=1 shows where.")
    return _FAILED
