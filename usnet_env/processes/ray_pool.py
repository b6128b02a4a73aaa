"""A pool of workers on the nodes of a Ray cluster.

Each worker is an actor of Ray with one core. It runs its tasks in a child process of its own, a :class:`ProcessPool` of
one process. So what a task does to its process is the outcome of that task, as on one machine. If instead the actor or
its node ends, no task is to blame: its tasks are run again by other workers.
"""

from __future__ import annotations

import logging
import os
import pickle
import sys
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any, Generic

from usnet_env.config import ArgumentError, how_to_install, quote
from usnet_env.processes.limits import Limits, ProcessDied
from usnet_env.processes.outcome import Outcome, ResultT, TaskT, every_task
from usnet_env.processes.parent import SendError, pickle_function, without_interrupts
from usnet_env.processes.pool import ProcessPool

_TASKS_AHEAD = 2  # tasks that a worker has received: one to run, and the next one so that it never waits
_MOST_ENDS = 3  # workers that may end during the same task, or one after the other before they have started
_LONGEST_REASON = 300  # characters
_GRACE = 10.0  # seconds


@dataclass(frozen=True)
class _Pickled:
    """A function as bytes: pickling it again and unpickling that returns the function."""

    data: bytes

    def __reduce__(self) -> tuple[Any, ...]:
        return pickle.loads, (self.data,)


class _Actor:
    """The worker's side, in a process of Ray."""

    def __init__(self, function: bytes, limits: Limits) -> None:
        # A child process would import the main script of this process again, which is Ray's own.
        sys.modules["__main__"].__dict__.pop("__file__", None)
        self._pool = ProcessPool[Any, Any](_Pickled(function), 1, limits)  # type: ignore[arg-type]

    def wait_until_made(self) -> None:
        """Return as soon as this object exists."""

    def run(self, task: Any) -> Outcome[Any, Any]:
        """Run a task in the child process."""
        try:
            return self._pool.run_one(task)
        except SendError as error:  # the child process did not start
            return Outcome(task, error=error)

    def finish(self) -> list[tuple[str, Any]]:
        """End the child process, and return the threads that it left."""
        self._pool.finish()
        return self._pool.left_threads


@dataclass
class _Call(Generic[TaskT]):
    """A task that a worker has received."""

    task: TaskT
    ends: int = 0  # how many workers have ended during it
    result: Any = None  # Ray's reference to its outcome


@dataclass(eq=False)
class _Worker(Generic[TaskT]):
    """A worker as the program sees it."""

    actor: Any  # Ray's handle
    starting: Any  # Ray's reference that is fulfilled when the actor has started; then None
    calls: deque[_Call[TaskT]] = field(default_factory=deque)  # what it has received; it runs the first one

    @property
    def awaited(self) -> Any:
        """What it sends next, as a reference; ``None`` if it has nothing to do."""
        return self.starting or (self.calls[0].result if self.calls else None)


class RayPool(Generic[TaskT, ResultT]):
    """Runs a function on tasks on the nodes of a Ray cluster.

    A worker that Ray has no core for waits, and joins when a node joins. A worker that ends is replaced.

    Args:
        function: what to call with each task. It is pickled; each worker has one copy.
        workers: number of workers, each with one core.
        limits: of each part that the function marks with :func:`limited`.
        address: of a Ray cluster, as ``ray.init`` takes it; ``None``: a new one on this machine, which ends with the
            pool. A program that is already connected stays connected to its cluster.

    Attributes:
        left_threads: as of :class:`ProcessPool`.

    Raises:
        ArgumentError: Ray is not installed, or there is no cluster at this address.
        SendError: the function cannot be pickled.
    """

    def __init__(
        self,
        function: Callable[[TaskT], ResultT],
        workers: int,
        limits: Limits = Limits(),  # noqa: B008  # frozen
        address: str | None = None,
    ) -> None:
        self.left_threads: list[tuple[str, TaskT]] = []
        data = pickle_function(function)
        self._ray, self._connected = _connect(address, workers)
        self._arguments = self._ray.put(data), limits
        self._actor = self._ray.remote(num_cpus=1)(_Actor)
        self._size = workers
        self._workers: list[_Worker[TaskT]] = []
        self._failed_starts = 0

    def run(
        self, tasks: Iterable[TaskT], is_wanted: Callable[[TaskT], bool] = every_task
    ) -> Generator[Outcome[TaskT, ResultT], None, None]:
        """Run all tasks, see :meth:`Backend.run`; the tasks that a worker had received when it ended are run again.

        Raises:
            SendError: the function cannot be unpickled in another process, or no worker could start.
        """
        queue, again = map(_Call[TaskT], tasks), deque[_Call[TaskT]]()
        try:
            while self._fill(queue, again):
                for worker in self._wait():
                    yield from self._read(worker, again)
                again = deque(call for call in again if is_wanted(call.task))
            self._finish()
        finally:
            self.close()

    def close(self) -> None:
        """End all workers; nothing is lost but unfinished tasks."""
        with without_interrupts():
            for worker in self._workers:
                with suppress(Exception):
                    self._ray.kill(worker.actor)
            self._workers.clear()
            if self._connected:
                self._ray.shutdown()
                self._connected = False

    def _fill(self, queue: Iterator[_Call[TaskT]], again: deque[_Call[TaskT]]) -> bool:
        """Start workers, and give tasks to those that have started; returns whether there is something to wait for."""
        while len(self._workers) < self._size:
            actor = self._actor.remote(*self._arguments)
            self._workers.append(_Worker(actor, actor.wait_until_made.remote()))
        for ahead in range(_TASKS_AHEAD):
            for worker in self._workers:
                if worker.starting is None and len(worker.calls) == ahead:
                    call = again.popleft() if again else next(queue, None)
                    if call is None:
                        return any(each.calls for each in self._workers)
                    call.result = worker.actor.run.remote(call.task)
                    worker.calls.append(call)
        return True

    def _wait(self) -> list[_Worker[TaskT]]:
        """Wait until a worker has sent something or has ended."""
        awaited = {worker.awaited: worker for worker in self._workers if worker.awaited is not None}
        self._ray.wait(list(awaited))
        ready, _ = self._ray.wait(list(awaited), num_returns=len(awaited), timeout=0)
        return [awaited[each] for each in ready]

    def _read(self, worker: _Worker[TaskT], again: deque[_Call[TaskT]]) -> Iterator[Outcome[TaskT, ResultT]]:
        """Read what a worker has sent."""
        try:
            outcome = self._ray.get(worker.awaited)
        except self._ray.exceptions.RayError as error:
            yield from self._replace(worker, error, again)
            return
        if worker.starting is not None:
            worker.starting, self._failed_starts = None, 0
            return
        if isinstance(outcome.error, SendError):
            raise outcome.error
        worker.calls.popleft()
        yield outcome

    def _replace(
        self, worker: _Worker[TaskT], error: Exception, again: deque[_Call[TaskT]]
    ) -> Iterator[Outcome[TaskT, ResultT]]:
        """Remove a worker that has ended; its tasks are run again, unless the first one has ended too many workers."""
        with suppress(Exception):  # it may be alive and out of reach
            self._ray.kill(worker.actor)
        self._workers.remove(worker)
        reason = " ".join(str(error).split())[-_LONGEST_REASON:].rstrip(".")
        if worker.starting is not None:
            self._failed_starts += 1
            if self._failed_starts == _MOST_ENDS:
                raise SendError(f"a Ray worker did not start: {reason}", started=False)
            return
        if not worker.calls:
            return
        worker.calls[0].ends += 1
        if worker.calls[0].ends == _MOST_ENDS:
            task = worker.calls.popleft().task
            yield Outcome(task, error=ProcessDied(f"{_MOST_ENDS} Ray workers ended during it: {reason}"))
        again.extend(worker.calls)

    def _finish(self) -> None:
        """Let the child processes end by themselves, and note the threads that keep some of them alive."""
        asked = [worker.actor.finish.remote() for worker in self._workers if worker.starting is None]
        for each in self._ray.wait(asked, num_returns=len(asked), timeout=_GRACE)[0]:
            with suppress(self._ray.exceptions.RayError):
                self.left_threads += self._ray.get(each)


def _connect(address: str | None, workers: int) -> tuple[Any, bool]:
    """Import Ray, and connect to a cluster unless this program is connected; returns whether that was done."""
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # nothing is sent about the cluster that starts here
    try:
        ray: Any = import_module("ray")
    except ImportError as error:
        raise ArgumentError(
            f"backend must be another one if Ray cannot be imported ({error}); {how_to_install('ray')}."
        ) from None
    if ray.is_initialized():
        return ray, False
    options: dict[str, Any] = {"num_cpus": workers, "include_dashboard": False} if address is None else {}
    try:
        ray.init(address or "local", logging_level=logging.ERROR, log_to_driver=False, **options)
    except (ConnectionError, ValueError, RuntimeError) as error:
        text = " ".join(str(error).split()).rstrip(".")
        raise ArgumentError(f"address must be that of a Ray cluster, got {quote(address)}: {text}.") from None
    return ray, True
