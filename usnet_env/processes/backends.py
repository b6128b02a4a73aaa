"""The backends by name: in this process, in child processes of it, or on the nodes of a Ray cluster."""

from __future__ import annotations

import threading
from collections.abc import Callable, Generator, Iterable
from typing import Any, Generic

from usnet_env.config import ArgumentError, quote
from usnet_env.processes.limits import Limits
from usnet_env.processes.outcome import Backend, Outcome, ResultT, TaskT, every_task
from usnet_env.processes.pool import ProcessPool
from usnet_env.processes.ray_pool import RayPool

#: Where tasks can run.
BACKENDS = ("serial", "processes", "ray")


class InProcess(Generic[TaskT, ResultT]):
    """Runs a function on tasks in this process, one after the other."""

    def __init__(self, function: Callable[[TaskT], ResultT]) -> None:
        self.left_threads: list[tuple[str, TaskT]] = []
        self._function = function

    def run(
        self, tasks: Iterable[TaskT], is_wanted: Callable[[TaskT], bool] = every_task
    ) -> Generator[Outcome[TaskT, ResultT], None, None]:
        """Run all tasks."""
        known = set(threading.enumerate())
        for task in tasks:
            try:
                outcome = Outcome(task, self._function(task))
            except (Exception, SystemExit) as error:  # a task must not end the program, least of all with status 0
                outcome = Outcome(task, error=error)
            yield outcome
            fresh = [each for each in threading.enumerate() if each not in known]
            self.left_threads += [(each.name, task) for each in fresh if not each.daemon]
            known.update(fresh)

    def close(self) -> None:
        """Do nothing: this process goes on."""


def check_backend(backend: Any, address: Any) -> None:
    """Check the name of a backend and the address of a Ray cluster.

    Raises:
        ArgumentError: ``backend`` is neither ``None`` nor in :data:`BACKENDS`, or ``address`` is not for it.
    """
    if not (backend is None or isinstance(backend, str)) or backend not in (None, *BACKENDS):
        raise ArgumentError(f"backend must be None or one of {', '.join(BACKENDS)}, got {quote(backend)}.")
    if not (address is None or (isinstance(address, str) and address)):
        raise ArgumentError(f"address must be None or the address of a Ray cluster, got {quote(address)}.")
    if address is not None and backend != "ray":
        raise ArgumentError(f"address must be None unless backend is 'ray', got {quote(address)}.")


def make_backend(
    backend: str,
    function: Callable[[TaskT], ResultT],
    workers: int = 1,
    limits: Limits = Limits(),  # noqa: B008  # frozen
    address: str | None = None,
) -> Backend[TaskT, ResultT]:
    """Make a backend.

    Args:
        backend: a name of :data:`BACKENDS`.
        function: what to call with each task. For other processes it is pickled.
        workers: number of processes.
        limits: of each part that the function marks with :func:`limited`, in other processes.
        address: of a Ray cluster, as ``ray.init`` takes it; ``None``: a new one on this machine.

    Raises:
        ArgumentError: Ray is not installed, or there is no cluster at this address.
        SendError: the function cannot be pickled.
    """
    if backend == "ray":
        return RayPool(function, workers, limits, address)
    return ProcessPool(function, workers, limits) if backend == "processes" else InProcess(function)
