"""The child's side: a process that ends with its parent, and runs one task after the other."""

from __future__ import annotations

import copy
import ctypes
import multiprocessing
import os
import signal
import sys
import threading
import traceback
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.connection import Connection
from multiprocessing.reduction import ForkingPickler
from typing import Any

from usnet_env.processes.limits import Limits, apply_limits

_PR_SET_PDEATHSIG = 1  # of prctl(2)


def prepare_child() -> None:
    """Make this new process a child: it ends with its parent, ignores Ctrl-C, and prints to standard error."""
    _end_with_parent()
    with suppress(ValueError, OSError):
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # a terminal sends Ctrl-C to all; the parent acts on it
    with suppress(OSError):
        os.dup2(2, 1)  # what a task prints must not mix with the output of the program


def _end_with_parent() -> None:
    """Make this process end when its parent ends, whatever ends the parent."""
    parent = multiprocessing.parent_process()
    if parent is None:
        return
    if sys.platform.startswith("linux"):
        # The kernel kills this process, even while foreign code holds the lock of the interpreter.
        with suppress(OSError, AttributeError):
            ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)

    def watch() -> None:
        parent.join()  # of a parent that ended before the line above, too
        os._exit(1)

    threading.Thread(target=watch, name="usnet-watch-parent", daemon=True).start()


def run_child(connection: Connection, limits: Limits) -> None:
    """Run tasks until the connection closes; the main function of a child process."""
    prepare_child()
    # The processes already share the cores. Numeric libraries that are imported later read this variable.
    os.environ.setdefault("OMP_NUM_THREADS", "1")

    def send(*message: Any) -> None:
        connection.send(message)

    apply_limits(limits, send)
    known = set(threading.enumerate())
    left: list[tuple[threading.Thread, Any]] = []
    try:
        try:
            function = connection.recv()
        except EOFError:
            raise
        except BaseException as error:
            send("refused", f"{type(error).__name__}: {error}")
            return
        send("ready")
        while (message := connection.recv()) is not None:  # None ends the process
            (task,) = message
            _send_result(connection, function, task)
            left += [(thread, task) for thread in threading.enumerate() if thread not in known]
            known.update(threading.enumerate())
    except (EOFError, OSError):  # the parent closed the connection
        return
    staying = [(thread.name, task) for thread, task in left if thread.is_alive() and not thread.daemon]
    with suppress(OSError):
        send("threads", staying)
    connection.close()


def _send_result(connection: Connection, function: Callable[[Any], Any], task: Any) -> None:
    """Run a task and send its result or its error."""
    pid = os.getpid()
    try:
        result = function(task)
        message = ForkingPickler.dumps(("done", result))
    except BaseException as error:
        trace = traceback.format_exc()
        try:
            copy.copy(error)  # builds it again from its arguments, as the parent will
            message = ForkingPickler.dumps(("error", error, trace))
        except Exception:
            message = ForkingPickler.dumps(("error", RuntimeError(f"{type(error).__name__}: {error}"), trace))
    if os.getpid() != pid:
        os._exit(1)
    connection.send_bytes(message)
