"""A pool of child processes that run a function on tasks."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from multiprocessing.connection import Connection, wait
from multiprocessing.reduction import ForkingPickler
from typing import Any, Generic

from usnet_env.processes.child import run_child
from usnet_env.processes.limits import Limits, ProcessDied
from usnet_env.processes.outcome import Outcome, ResultT, TaskT, every_task
from usnet_env.processes.parent import (
    RemoteTraceback,
    SendError,
    describe_end,
    end_process,
    pickle_function,
    start_process,
    without_interrupts,
)

_TASKS_AHEAD = 2  # tasks that a process has received: one to run, and the next one so that it never waits
_POLL = 1.0  # seconds; a process whose death no pipe reports, because a child of its own holds the pipe, is found then
_GRACE = 5.0  # seconds in which a process may end by itself after its last task


@dataclass(eq=False)
class _Process(Generic[TaskT]):
    """A child process, as its parent sees it."""

    process: Any
    connection: Connection
    ready: bool = False
    tasks: deque[TaskT] = field(default_factory=deque)
    during: str | None = None
    deadline: float | None = None


class ProcessPool(Generic[TaskT, ResultT]):
    """Runs a function on tasks in several child processes.

    Args:
        function: what to call with each task. It is pickled, so it must be importable in a new process, or pickle
            itself in another way. Each process has one copy.
        workers: number of processes.
        limits: of each part that the function marks with :func:`limited`.

    Attributes:
        left_threads: after :meth:`finish`: names of threads that a task started, that are no daemons, and because of
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
        self._function = pickle_function(function)

    def __enter__(self) -> ProcessPool[TaskT, ResultT]:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def run(
        self, tasks: Iterable[TaskT], is_wanted: Callable[[TaskT], bool] = every_task
    ) -> Generator[Outcome[TaskT, ResultT], None, None]:
        """Run all tasks, see :meth:`Backend.run`.

        Raises:
            SendError: the function cannot be unpickled in another process, or a process could not start.
        """
        try:
            yield from self._run(iter(tasks), is_wanted)
            self.finish()
        finally:
            self.close()

    def run_one(self, task: TaskT) -> Outcome[TaskT, ResultT]:
        """Run one task; the processes stay for the next one.

        Raises:
            SendError: as :meth:`run`.
        """
        (outcome,) = self._run(iter([task]), every_task)
        return outcome

    def _run(self, queue: Iterator[TaskT], is_wanted: Callable[[TaskT], bool]) -> Iterator[Outcome[TaskT, ResultT]]:
        again = deque[TaskT]()  # tasks that a process had received when it died
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
                    yield from self._bury(each, again, describe_end(each.process))
                elif each.deadline is not None and time.monotonic() > each.deadline:
                    late = f"it took longer than {self._limits.seconds:g} seconds, the time limit"
                    yield from self._bury(each, again, late)

    def close(self) -> None:
        """Kill all processes; nothing is lost but unfinished tasks."""
        with without_interrupts():
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
        with without_interrupts():  # a process that an interrupt finds here must be in the list, or it is never killed
            each = _Process[TaskT](*start_process(run_child, self._limits))
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
            elif kind == "done":
                yield Outcome(each.tasks.popleft(), result=content[0])
            elif kind == "error":
                error, trace = content
                error.__cause__ = RemoteTraceback(trace)
                yield Outcome(each.tasks.popleft(), error=error)

    def _bury(self, each: _Process[TaskT], again: deque[TaskT], reason: str) -> Iterator[Outcome[TaskT, ResultT]]:
        """Remove a process that has died or is late; its first task has failed, the others are tried again."""
        with without_interrupts():
            end_process(each.process, each.connection)
            self._processes.remove(each)
        if not each.ready:
            raise SendError(f"a worker process did not start: {reason}", started=False)
        if each.tasks:
            task = each.tasks.popleft()
            again.extendleft(reversed(each.tasks))
            yield Outcome(task, error=ProcessDied(reason, each.during))

    def finish(self) -> None:
        """Let the processes end by themselves; :meth:`close` kills those that threads keep alive."""
        for each in self._processes:
            # Only the direction to the child is closed, so that its last message can still be read.
            with suppress(OSError):
                each.connection.send(None)
        end = time.monotonic() + _GRACE
        for each in self._processes:
            kind, content = "", []
            with suppress(EOFError, OSError):
                while kind != "threads" and each.connection.poll(max(0.0, end - time.monotonic())):
                    kind, *content = each.connection.recv()
            each.process.join(max(0.0, end - time.monotonic()))
            if kind == "threads" and each.process.exitcode is None:
                self.left_threads += content[0]
