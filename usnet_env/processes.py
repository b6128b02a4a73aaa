"""Run functions in child processes, with limits of time and memory.

A :class:`ProcessPool` starts its processes anew (they inherit no memory), gives each task to one of them, and yields
the outcomes as they come. A child process that ends before its task is finished does not end the run: the outcome of
that task is a :class:`ProcessDied` with the reason, and a new process takes the other tasks.

A child process never outlives its parent: it ends with the parent, whatever ended the parent. The pool kills its
processes when it is closed, so nothing waits for a task that hangs.

Inside a task, :func:`limited` marks the part to which the limits apply, such as one answer of a detector::

    def play(seed):                      # in a module
        with limited("round 1"):
            return detector.detect(window)

    with ProcessPool(play, workers=2, limits=Limits(seconds=60, megabytes=2000)) as pool:
        for outcome in pool.run(range(10)):
            print(outcome.task, outcome.result or outcome.error)
"""

from __future__ import annotations

import copy
import ctypes
import multiprocessing
import os
import signal
import sys
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.reduction import ForkingPickler
from typing import Annotated, Any, Generic, TypeVar

from pydantic import Field

from usnet_env.config import ArgumentError, Config

__all__ = ["Limits", "Outcome", "ProcessDied", "ProcessPool", "SendError", "limited", "run_limited"]

_TASKS_AHEAD = 2  # tasks that a process has received: one to run, and the next one so that it never waits
_POLL = 1.0  # seconds; a process whose death no pipe reports, because a child of its own holds the pipe, is found then
_GRACE = 5.0  # seconds in which a process may end by itself after its last task

_MEGABYTE = 1_000_000
_PR_SET_PDEATHSIG = 1  # of prctl(2)

TaskT = TypeVar("TaskT")
ResultT = TypeVar("ResultT")


class Limits(Config):
    """Limits of each part of a task that :func:`limited` marks.

    Args:
        seconds: wall time; ``None``: no limit. A process that exceeds it is killed.
        megabytes: memory in 10^6 bytes that the process may allocate beyond what it holds when the part begins;
            ``None``: no limit. Beyond it, allocations fail: in Python with ``MemoryError``. Linux only.

    Raises:
        ArgumentError: a limit is not a positive number, or this system cannot limit memory.
    """

    seconds: Annotated[float, Field(gt=0)] | None = None
    megabytes: Annotated[float, Field(gt=0)] | None = None

    def __init__(self, **values: Any) -> None:
        super().__init__(**values)
        if self.megabytes is not None and not sys.platform.startswith("linux"):
            raise ArgumentError(f"megabytes must be None on a system other than Linux, got {self.megabytes:g}.")

    @property
    def any(self) -> bool:
        """Whether there is a limit."""
        return self.seconds is not None or self.megabytes is not None


class ProcessDied(RuntimeError):
    """A child process ended, or was killed, before it finished a task.

    Args:
        reason: why, as the second half of a sentence without its full stop: ``"its process ended itself with status
            0"``.
        during: what the process had marked last with :func:`limited` if it was inside, else ``None``.
    """

    def __init__(self, reason: str, during: str | None = None) -> None:
        super().__init__(reason, during)
        self.reason = reason
        self.during = during

    def __str__(self) -> str:
        return f"{self.reason}, in {self.during}" if self.during else self.reason


class SendError(RuntimeError):
    """A function cannot be sent to another process, or a process could not start.

    Args:
        text: the reason.
        started: whether there was a process, or none was needed to find the reason.
    """

    def __init__(self, text: str, started: bool = True) -> None:
        super().__init__(text)
        self.started = started


@dataclass(frozen=True)
class Outcome(Generic[TaskT, ResultT]):
    """What came of a task: a result, or an error.

    Args:
        task: the task.
        result: what the function returned; ``None`` after an error.
        error: what the function raised, or :class:`ProcessDied`; ``None`` after success.
    """

    task: TaskT
    result: ResultT | None = None
    error: BaseException | None = None


class _RemoteTraceback(Exception):  # only shown as the cause of an error
    """The traceback of an error in a child process, as text."""

    def __str__(self) -> str:
        return f"\n{self.args[0]}"


# ---------------------------------------------------------------------------------------------------- the child's side


@dataclass
class _Child:
    """This process, if it is a child of a pool."""

    connection: Connection
    limits: Limits
    pid: int = field(default_factory=os.getpid)
    inside: bool = False

    def send(self, *message: Any) -> None:
        self.connection.send(message)


_child: _Child | None = None


@contextmanager
def limited(what: str) -> Iterator[None]:
    """Mark a part of a task to which the limits of the pool apply; outside a pool it does nothing.

    Parts do not nest: inside another part it does nothing.

    Args:
        what: a name of the part for reasons, such as ``"episode 3, round 1"``.

    Raises:
        MemoryError: the part needed more memory than its limit.
    """
    child = _child
    if child is None or child.inside or not child.limits.any:
        yield
        return
    child.inside = True
    if child.limits.seconds is not None:
        child.send("begin", what)
    before = _limit_memory(child.limits.megabytes)
    try:
        yield
    except MemoryError:
        if before is None:
            raise
        raise MemoryError(f"it needed more than {child.limits.megabytes:g} MB, the memory limit") from None
    finally:
        if os.getpid() != child.pid:  # a copy of the process, made by os.fork inside the part, must not go on as well
            os._exit(1)
        _restore_memory(before)
        child.inside = False
        if child.limits.seconds is not None:
            child.send("end")


def _limit_memory(megabytes: float | None) -> tuple[int, int] | None:
    """Limit what this process may allocate from now on; returns the limits before."""
    if megabytes is None:
        return None
    import resource

    before = resource.getrlimit(resource.RLIMIT_DATA)
    with open("/proc/self/statm", "rb") as file:
        held = int(file.read().split()[5]) * resource.getpagesize()
    most = held + int(megabytes * _MEGABYTE)
    if before[1] != resource.RLIM_INFINITY:
        most = min(most, before[1])
    resource.setrlimit(resource.RLIMIT_DATA, (most, before[1]))
    return before


def _restore_memory(before: tuple[int, int] | None) -> None:
    if before is not None:
        import resource

        resource.setrlimit(resource.RLIMIT_DATA, before)


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


def _run_child(connection: Connection, limits: Limits) -> None:
    """Run tasks until the connection closes; the main function of a child process."""
    global _child
    _end_with_parent()
    with suppress(ValueError, OSError):
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # a terminal sends Ctrl-C to all; the parent acts on it
    with suppress(OSError):
        os.dup2(2, 1)  # what a task prints must not mix with the output of the program
    # The processes already share the cores. Numeric libraries that are imported later read this variable.
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    child = _child = _Child(connection, limits)
    known = set(threading.enumerate())
    left: list[tuple[threading.Thread, Any]] = []
    try:
        try:
            function = connection.recv()
        except EOFError:
            raise
        except BaseException as error:
            child.send("refused", f"{type(error).__name__}: {error}")
            return
        child.send("ready")
        while (message := connection.recv()) is not None:  # None ends the process
            (task,) = message
            _send_result(child, function, task)
            left += [(thread, task) for thread in threading.enumerate() if thread not in known]
            known.update(threading.enumerate())
    except (EOFError, OSError):  # the parent closed the connection
        return
    staying = [(thread.name, task) for thread, task in left if thread.is_alive() and not thread.daemon]
    with suppress(OSError):
        child.send("threads", staying)
    connection.close()


def _send_result(child: _Child, function: Callable[[Any], Any], task: Any) -> None:
    """Run a task and send its result or its error."""
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
    if os.getpid() != child.pid:
        os._exit(1)
    child.connection.send_bytes(message)


# --------------------------------------------------------------------------------------------------- the parent's side


@contextmanager
def _without_interrupts() -> Iterator[None]:
    """Hold back Ctrl-C until the end of the block; processes started inside never receive it."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@dataclass(eq=False)
class _Process(Generic[TaskT]):
    """A child process, as its parent sees it."""

    process: Any
    connection: Connection
    ready: bool = False
    tasks: deque[TaskT] = field(default_factory=deque)
    during: str | None = None
    deadline: float | None = None

    def describe_end(self) -> str:
        """Why the process has ended."""
        code = self.process.exitcode
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


class ProcessPool(Generic[TaskT, ResultT]):
    """Runs a function on tasks in several child processes.

    Args:
        function: what to call with each task. It is pickled, so it must be importable in a new process, or pickle
            itself in another way. Each process has one copy.
        workers: number of processes.
        limits: of each part that the function marks with :func:`limited`.

    Attributes:
        left_threads: after the last outcome: names of threads that a task started, that are no daemons, and because of
            which a process did not end by itself, each with its task.
    """

    def __init__(
        self,
        function: Callable[[TaskT], ResultT],
        workers: int,
        limits: Limits = Limits(),  # noqa: B008  # frozen
    ) -> None:
        self.left_threads: list[tuple[str, TaskT]] = []
        self._workers = workers
        self._limits = limits
        self._processes: list[_Process[TaskT]] = []
        self._threads: dict[int, list[tuple[str, TaskT]]] = {}
        try:
            self._function = ForkingPickler.dumps(function)
        except Exception as error:
            raise SendError(f"{type(error).__name__}: {error}") from error

    def __enter__(self) -> ProcessPool[TaskT, ResultT]:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def run(
        self, tasks: Iterable[TaskT], is_wanted: Callable[[TaskT], bool] = lambda task: True
    ) -> Iterator[Outcome[TaskT, ResultT]]:
        """Run all tasks; the outcomes come in the order in which they are finished.

        Args:
            tasks: read one after the other, a few ahead of the outcomes.
            is_wanted: whether a task should still be run that another process had received and not begun when it died.

        Raises:
            SendError: the function cannot be unpickled in another process, or a process could not start.
        """
        queue, again = iter(tasks), deque[TaskT]()  # `again`: tasks that a process had received when it died
        try:
            while True:
                again = deque(filter(is_wanted, again))
                self._fill(queue, again)
                if not any(each.tasks for each in self._processes):
                    break
                self._wait()
                for each in list(self._processes):
                    dead = each.process.exitcode is not None  # asked first: all that it sent can then be read
                    yield from self._read(each)
                    if dead or each.connection.closed:
                        yield from self._bury(each, again)
                    elif each.deadline is not None and time.monotonic() > each.deadline:
                        yield self._kill_late(each, again)
            self._end_processes()
        finally:
            self.close()

    def close(self) -> None:
        """Kill all processes; nothing is lost but unfinished tasks."""
        with _without_interrupts():
            for each in self._processes:
                each.process.kill()
            for each in self._processes:
                each.process.join()
                each.connection.close()
            self._processes.clear()

    def _fill(self, queue: Iterator[TaskT], again: deque[TaskT]) -> None:
        """Give tasks to the processes, the idle ones first, and start processes while there are too few."""
        fresh: list[_Process[TaskT]] = []
        for ahead in range(1, _TASKS_AHEAD + 1):
            while True:
                free = next((each for each in self._processes if len(each.tasks) < ahead), None)
                if free is None and (ahead > 1 or len(self._processes) == self._workers):
                    break
                try:
                    task = again.popleft() if again else next(queue)
                except StopIteration:
                    break
                if free is None:
                    free = self._start()
                    fresh.append(free)
                free.tasks.append(task)
                if free not in fresh:
                    self._send(free, ForkingPickler.dumps((task,)))
        for each in fresh:  # after all have started: a long message waits until its process reads it
            self._send(each, self._function)
            for task in each.tasks:
                self._send(each, ForkingPickler.dumps((task,)))

    @staticmethod
    def _send(each: _Process[TaskT], message: Any) -> None:
        with suppress(OSError):  # it has died, which `_wait` will notice
            each.connection.send_bytes(message)

    def _start(self) -> _Process[TaskT]:
        context = multiprocessing.get_context("spawn")
        resource_tracker.ensure_running()  # starting it would let interrupts through below
        ours, theirs = context.Pipe()
        process = context.Process(target=_run_child, args=(theirs, self._limits))
        with _without_interrupts():
            try:
                process.start()
            except RuntimeError as error:  # this process is itself starting: it imports an unguarded main script
                raise SendError(f"a worker process could not start: {type(error).__name__}", started=False) from error
            finally:
                theirs.close()
            each = _Process[TaskT](process, ours)
            self._processes.append(each)
        return each

    def _wait(self) -> None:
        """Wait until a process has sent something, has died or is late."""
        now = time.monotonic()
        deadlines = [each.deadline for each in self._processes if each.deadline is not None]
        timeout = max(0.0, min([_POLL, *(deadline - now for deadline in deadlines)]))
        handles: list[Any] = [handle for each in self._processes for handle in (each.connection, each.process.sentinel)]
        wait(handles, timeout)

    def _read(self, each: _Process[TaskT]) -> Iterator[Outcome[TaskT, ResultT]]:
        """Read all messages of a process."""
        while not each.connection.closed:
            try:
                if not each.connection.poll():
                    break
                kind, *content = each.connection.recv()
            except (EOFError, OSError):
                each.process.join(_GRACE)  # the connection closes a moment before the process has its exit status
                each.connection.close()
                break
            if kind == "ready":
                each.ready = True
            elif kind == "refused":
                raise SendError(content[0])
            elif kind == "begin":
                each.during = content[0]
                if self._limits.seconds is not None:
                    each.deadline = time.monotonic() + self._limits.seconds
            elif kind == "end":
                each.during = each.deadline = None
            elif kind == "threads":
                self._threads[each.process.pid] = content[0]
            elif kind == "done":
                yield Outcome(each.tasks.popleft(), result=content[0])
            elif kind == "error":
                error, trace = content
                error.__cause__ = _RemoteTraceback(trace)
                yield Outcome(each.tasks.popleft(), error=error)

    def _bury(self, each: _Process[TaskT], again: deque[TaskT]) -> Iterator[Outcome[TaskT, ResultT]]:
        """Remove a process that has died; its first task has failed, the others are tried again."""
        reason = each.describe_end()
        self._remove(each)
        if not each.ready:
            raise SendError(f"a worker process did not start: {reason}", started=False)
        if each.tasks:
            task = each.tasks.popleft()
            again.extendleft(reversed(each.tasks))
            yield Outcome(task, error=ProcessDied(reason, each.during))

    def _kill_late(self, each: _Process[TaskT], again: deque[TaskT]) -> Outcome[TaskT, ResultT]:
        self._remove(each)
        task = each.tasks.popleft()
        again.extendleft(reversed(each.tasks))
        reason = f"it took longer than {self._limits.seconds:g} seconds, the time limit"
        return Outcome(task, error=ProcessDied(reason, each.during))

    def _remove(self, each: _Process[TaskT]) -> None:
        with _without_interrupts():
            each.process.kill()
            each.process.join()
            each.connection.close()
            self._processes.remove(each)

    def _end_processes(self) -> None:
        """Let the processes end by themselves; those that threads keep alive are killed by :meth:`close`."""
        for each in self._processes:
            # Only the direction to the child is closed, so that its last message can still be read.
            with suppress(OSError):
                each.connection.send(None)
        end = time.monotonic() + _GRACE
        for each in self._processes:
            with suppress(EOFError, OSError):
                while each.connection.poll(max(0.0, end - time.monotonic())):
                    kind, *content = each.connection.recv()
                    if kind == "threads":
                        self._threads[each.process.pid] = content[0]
                        break
            staying = self._threads.get(each.process.pid, [])
            each.process.join(max(0.0, end - time.monotonic()))
            if each.process.exitcode is None:
                self.left_threads += staying


def run_limited(function: Callable[[TaskT], ResultT], argument: TaskT, limits: Limits = Limits()) -> ResultT:  # noqa: B008
    """Call a function in a child process and return its result.

    Args:
        function: as :class:`ProcessPool` takes it. What it marks with :func:`limited` has the limits.
        argument: its only argument.
        limits: limits of each marked part.

    Raises:
        ProcessDied: the process ended, or was killed, before the function returned.
        SendError: the function or argument cannot be sent to another process.
    """
    with ProcessPool[TaskT, ResultT](function, 1, limits) as pool:
        outcome = next(iter(pool.run([argument])))
    if outcome.error is not None:
        raise outcome.error
    return outcome.result  # type: ignore[return-value]  # without an error it is the function's
