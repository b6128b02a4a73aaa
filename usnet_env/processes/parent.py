"""The parent's side of a child process: start it, kill it, and say why it ended."""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
from multiprocessing.reduction import ForkingPickler
from typing import Any


class SendError(RuntimeError):
    """A function cannot be sent to another process, or a process could not start.

    Args:
        text: the reason.
        started: whether there was a process, or none was needed to find the reason.
    """

    def __init__(self, text: str, started: bool = True) -> None:
        super().__init__(text)
        self.started = started


def pickle_function(function: Callable[..., Any]) -> bytes:
    """Pickle a function for a new process.

    Raises:
        SendError: it cannot be pickled.
    """
    try:
        return bytes(ForkingPickler.dumps(function))
    except Exception as error:
        raise SendError(f"{type(error).__name__}: {error}") from error


class RemoteTraceback(Exception):  # only shown as the cause of an error
    """The traceback of an error in a child process, as text."""

    def __str__(self) -> str:
        return f"\n{self.args[0]}"


@contextmanager
def without_interrupts() -> Iterator[None]:
    """Hold back Ctrl-C until the end of the block; processes started inside never receive it."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def start_process(target: Callable[..., None], *arguments: Any) -> tuple[Any, Connection]:
    """Start a new process, which inherits no memory of this one.

    Args:
        target: its main function, called with its end of a connection and the arguments.
        arguments: what else the function gets; they are pickled.

    Returns:
        The process, and this end of the connection.

    Raises:
        SendError: it could not start.
    """
    context = multiprocessing.get_context("spawn")
    resource_tracker.ensure_running()  # starting it would let interrupts through below
    ours, theirs = context.Pipe()
    process = context.Process(target=target, args=(theirs, *arguments))
    with without_interrupts():
        try:
            process.start()
        except RuntimeError as error:  # this process is itself starting: it imports an unguarded main script
            raise SendError(f"a worker process could not start: {type(error).__name__}", started=False) from error
        finally:
            theirs.close()
    return process, ours


def end_process(process: Any, connection: Connection) -> None:
    """Kill a child process, whatever it does."""
    with without_interrupts():
        process.kill()
        process.join()
        connection.close()


def describe_end(process: Any) -> str:
    """Why a child process has ended, as the second half of a sentence."""
    code = process.exitcode
    if code is None:
        return "its process closed its connection"
    if code >= 0:
        return f"it ended its process with status {code}"
    try:
        name = signal.Signals(-code).name
    except ValueError:
        name = f"signal {-code}"
    hint = ", perhaps because memory ran out" if name == "SIGKILL" else ""
    return f"its process was killed by {name}{hint}"
