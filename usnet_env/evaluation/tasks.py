"""Run tasks in worker processes, send functions to them, and say why one failed."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import pickle
import signal
import threading
import time
import traceback
import warnings
from collections.abc import Callable, Generator, Iterable, Iterator, Sized
from concurrent.futures.process import BrokenProcessPool
from importlib import import_module
from itertools import islice
from pathlib import Path
from sysconfig import get_paths
from typing import Any, TypeVar
from uuid import uuid4

import cloudpickle
import joblib
import numpy as np
from joblib.externals.loky import get_reusable_executor
from numpy.typing import NDArray

from usnet_env.config import ArgumentError, MissingExtraError, how_to_install
from usnet_env.parts import REGISTRIES

TaskT = TypeVar("TaskT")
ResultT = TypeVar("ResultT")

LONGEST_REASON = 300  # characters of a reason in a row, and of a sentence that is printed
_GROUP_SIZE = 16  # tasks of a Ray worker between two times when rows are kept
_FOREIGN = (str(Path(__file__).parents[1]), "<", "site-packages", "dist-packages", get_paths()["stdlib"])

_received: dict[str, Callable[[Any], Any]] = {}  # the function that this worker process runs, by the token of its call


class EvaluationError(RuntimeError):
    """A detector failed, or a run could not go on; the reason is what a row keeps: ``"round 2: KeyError: …"``."""

    def __init__(self, sentence: str, reason: str = "") -> None:
        super().__init__(sentence)
        self.reason = reason


def describe_failure(error: BaseException) -> str:
    """What a detector raised, and the line of its code: ``ZeroDivisionError: no luck (mine.py, line 3, in detect)``."""
    text = " ".join(str(error).split()).rstrip(".")
    if isinstance(error, EvaluationError):  # of a child process, which has named the line
        return text
    cause = text if isinstance(error, ArgumentError) else f"{type(error).__name__}: {text}".rstrip(": ")
    frames = traceback.extract_tb(error.__traceback__)
    lines = [frame for frame in frames if not any(part in frame.filename for part in _FOREIGN)]
    location = f" ({Path(lines[-1].filename).name}, line {lines[-1].lineno}, in {lines[-1].name})" if lines else ""
    length = LONGEST_REASON - len(location) - 40  # which leaves room for the round
    return f"{cause if len(cause) <= length else cause[:length] + '…'}{location}"


def map_tasks(
    function: Callable[[TaskT], ResultT], tasks: Iterable[TaskT], *, workers: int = 1, backend: str | None = None
) -> Generator[ResultT, None, None]:
    """Run a function on tasks, in this process or in worker processes of joblib.

    Workers get the function once, by value, together with the parts that this program has registered: functions and
    classes of a script or a notebook work there. If the function has state, each worker has a copy for the whole call.

    Args:
        function: what to call with each task.
        tasks: the tasks.
        workers: largest number of processes; no more than there are tasks, and 1 is this process.
        backend: ``"serial"``: this process; ``"processes"`` or ``None``: child processes; ``"ray"``: the nodes of a Ray
            cluster, at the address in the environment variable ``RAY_ADDRESS``, or this machine.

    Yields:
        The results in the order of the tasks, as they come; those of Ray come in groups.

    Raises:
        EvaluationError: a worker process was ended.
    """
    workers = min(workers, len(tasks)) if isinstance(tasks, Sized) else workers
    if workers <= 1 or backend == "serial":
        yield from map(function, tasks)
        return
    payload = np.frombuffer(dumps(function), np.uint8)  # joblib shares large arrays between workers
    token = uuid4().hex
    calls = (joblib.delayed(_run_task)(token, payload, task) for task in tasks)
    try:
        yield from _run_on_ray(calls, workers) if backend == "ray" else _run_in_processes(calls, workers)
    except BrokenProcessPool:
        raise EvaluationError(
            "a worker process was ended, by a signal, for want of memory, or by what it played. The same call resumes "
            "a run that has a folder. In isolation, a detector that ends its process is a failed row."
        ) from None


def _run_in_processes(calls: Iterator[Any], workers: int) -> Iterator[Any]:
    """Run calls in child processes, which have ended when this returns: a process waits for those that are left."""
    # Begun by `become_worker`, a worker that has no task yet ends with its parent too.
    parallel = joblib.Parallel(n_jobs=workers, backend="loky", return_as="generator", initializer=become_worker)
    results = parallel(calls)
    try:
        for result in results:  # noqa: UP028  # `yield from` would close it before warnings are ignored
            yield result
    finally:
        with warnings.catch_warnings():  # that tasks were begun in vain
            warnings.simplefilter("ignore")
            results.close()
        get_reusable_executor().shutdown()


def _run_on_ray(calls: Iterator[Any], workers: int) -> Iterator[Any]:
    """Run calls on a Ray cluster in groups: joblib's generators do not know Ray."""
    try:
        import_module("ray.util.joblib").register_ray()
    except ImportError:
        raise MissingExtraError(f"backend 'ray' needs Ray; {how_to_install('ray')}.") from None
    try:
        with joblib.parallel_config("ray"), joblib.Parallel(n_jobs=workers) as parallel:
            while group := list(islice(calls, workers * _GROUP_SIZE)):
                yield from parallel(group)
    except import_module("ray.exceptions").RayActorError:
        raise BrokenProcessPool from None


def _run_task(token: str, payload: NDArray[np.uint8], task: Any) -> Any:
    """Run a task in a worker process, with the function that came with the first task of the call."""
    if token not in _received:
        become_worker()
        _received.clear()
        _received[token] = loads(payload.tobytes())
    return _received[token](task)


def dumps(value: Any) -> bytes:
    """Pickle a value for another process, with what this program has registered."""
    parts = {kind: registry.registered for kind, registry in REGISTRIES.items() if registry.registered}
    modules = {REGISTRIES[kind].home for kind in parts}
    for registered in parts.values():
        modules |= {getattr(part, "function", part).__module__ for part in registered.values()}
    return cloudpickle.dumps((modules - {"__main__"}, cloudpickle.dumps((parts, value))))


def loads(data: bytes) -> Any:
    """The value of :func:`dumps`, after what was registered there has been registered in this process too."""
    modules, inner = pickle.loads(data)
    for module in modules:
        with contextlib.suppress(ImportError):
            import_module(module)  # which may register its parts itself
    parts, value = pickle.loads(inner)
    for kind, registered in parts.items():
        REGISTRIES[kind].registered |= registered | REGISTRIES[kind].registered
    return value


def become_worker() -> None:
    """Make this process a worker: it ends with its parent, ignores Ctrl-C, and prints to standard error."""
    started_by = multiprocessing.parent_process()  # which may have ended while this process imported its modules
    parent = os.getppid() if started_by is None else started_by.pid

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(1)
        os._exit(1)

    threading.Thread(target=watch, name="usnet-watch-parent", daemon=True).start()
    with contextlib.suppress(ValueError):  # not the main thread
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # a terminal sends Ctrl-C to all; the parent acts on it
    os.dup2(2, 1)  # what a detector prints must not mix with the output of the program
