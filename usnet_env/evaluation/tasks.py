"""Run tasks in worker processes, and what such a process needs: its manners, and arrays that travel without pickle."""

from __future__ import annotations

import contextlib
import io
import json
import os
import pickle
import signal
import sys
import threading
import time
import warnings
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from concurrent.futures.process import BrokenProcessPool
from importlib import import_module
from itertools import islice
from typing import Any, TypeVar
from uuid import uuid4

import cloudpickle
import joblib
import numpy as np
from numpy.typing import NDArray

from usnet_env.config import MissingExtraError, how_to_install
from usnet_env.evaluation.errors import EvaluationError
from usnet_env.parts import REGISTRIES

TaskT = TypeVar("TaskT")
ResultT = TypeVar("ResultT")

_MEGABYTE = 1_000_000
_HEADER = "_header"
_AT_ONCE = 16  # tasks of a Ray worker between two times when rows are kept

_received: dict[str, Callable[[Any], Any]] = {}  # the function of the run that this worker process plays, by its token


def map_tasks(
    function: Callable[[TaskT], ResultT],
    tasks: Iterable[TaskT],
    *,
    workers: int = 1,
    backend: str | None = None,
    ordered: bool = True,
) -> Generator[ResultT, None, None]:
    """Run a function on tasks, in this process or in worker processes of joblib.

    Workers get the function once, by value, together with the parts that this program has registered: functions and
    classes of a script or a notebook work there.

    Args:
        function: what to call with each task. If it has state, each worker has a copy that lasts for the whole call.
        tasks: the tasks.
        workers: number of processes.
        backend: ``"serial"``: this process; ``"processes"``: child processes; ``"ray"``: the nodes of a Ray cluster, at
            the address in the environment variable ``RAY_ADDRESS``, or on this machine. A single worker is this
            process, whatever the backend. ``None``: ``"processes"``.
        ordered: whether the results come in the order of the tasks; otherwise as they are finished.

    Yields:
        The results, as they come; those of Ray come in groups.

    Raises:
        EvaluationError: a worker process was ended.
        MissingExtraError: Ray is not installed.
        Exception: what the function raised.
    """
    if workers == 1 or backend == "serial":
        yield from map(function, tasks)
        return
    payload = np.frombuffer(dumps(function), np.uint8)  # joblib shares large arrays between workers
    token = uuid4().hex
    calls = (joblib.delayed(_run_task)(token, payload, task) for task in tasks)
    try:
        if backend == "ray":
            yield from _run_on_ray(calls, workers)
        else:
            how = "generator" if ordered else "generator_unordered"
            results = joblib.Parallel(n_jobs=workers, backend="loky", return_as=how)(calls)
            try:
                for result in results:  # noqa: UP028  # `yield from` would close it before warnings are ignored
                    yield result
            finally:
                with warnings.catch_warnings():  # that tasks were begun in vain
                    warnings.simplefilter("ignore")
                    results.close()
    except BrokenProcessPool:
        raise EvaluationError(
            "a worker process was ended, by a signal, for want of memory, or by what it played. Finished rows are kept "
            "if there is a folder: the same call plays the others. With a limit or in isolation, a detector that ends "
            "its process has failed, and the others go on."
        ) from None


def _run_on_ray(calls: Iterator[Any], workers: int) -> Iterator[Any]:
    """Run calls on a Ray cluster in groups: joblib's generators do not know Ray."""
    try:
        import_module("ray.util.joblib").register_ray()
    except ImportError:
        raise MissingExtraError(f"backend 'ray' needs Ray; {how_to_install('ray')}.") from None
    with joblib.parallel_config("ray"), joblib.Parallel(n_jobs=workers) as parallel:
        while group := list(islice(calls, workers * _AT_ONCE)):
            yield from parallel(group)


def _run_task(token: str, payload: NDArray[np.uint8], task: Any) -> Any:
    """Run a task in a worker process, with the function that it received before, if it is of the same run."""
    if token not in _received:
        if not _received:
            become_worker()
        for function in _received.values():
            getattr(function, "close", lambda: None)()
        _received.clear()
        _received[token] = loads(payload.tobytes())
    return _received[token](task)


def dumps(value: Any) -> bytes:
    """Pickle a value for another process, with what this program has registered, and where it finds modules."""
    parts = []
    for kind, registry in REGISTRIES.items():
        for name, part in registry.registered.items():
            origin = getattr(part, "function", None) or getattr(part, "rule", None) or part
            modules = {registry.home, getattr(origin, "__module__", registry.home)} - {"__main__"}
            with contextlib.suppress(Exception):  # what cannot be pickled is missing there: its name is then refused
                parts.append((kind, name, modules, cloudpickle.dumps(part)))
    return cloudpickle.dumps((sys.path, parts, cloudpickle.dumps(value)))


def loads(data: bytes) -> Any:
    """The value of :func:`dumps`, after what was registered there has been registered in this process too."""
    path, parts, value = pickle.loads(data)
    sys.path += [folder for folder in path if folder not in sys.path]
    for kind, name, modules, part in parts:
        with contextlib.suppress(Exception):  # a module cannot be imported here: its name is refused if it is used
            for module in modules:
                import_module(module)
            if name not in REGISTRIES[kind].registered:
                REGISTRIES[kind].register(name, pickle.loads(part))
    return pickle.loads(value)


def become_worker() -> None:
    """Make this process a worker: it ends with its parent, ignores Ctrl-C, and prints to standard error."""
    parent = os.getppid()

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(1)
        os._exit(1)

    threading.Thread(target=watch, name="usnet-watch-parent", daemon=True).start()
    with contextlib.suppress(ValueError):  # not the main thread
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # a terminal sends Ctrl-C to all; the parent acts on it
    os.dup2(2, 1)  # what a detector prints must not mix with the output of the program


@contextlib.contextmanager
def limit_memory(megabytes: float | None) -> Iterator[None]:
    """Limit what this process may allocate in the block beyond what it holds; ``None``: no limit. Linux only.

    Raises:
        MemoryError: the block needed more.
    """
    if megabytes is None:
        yield
        return
    import resource

    soft, hard = resource.getrlimit(resource.RLIMIT_DATA)
    with open("/proc/self/statm", "rb") as file:
        held = int(file.read().split()[5]) * resource.getpagesize()
    most = held + int(megabytes * _MEGABYTE)
    resource.setrlimit(resource.RLIMIT_DATA, (most if hard == resource.RLIM_INFINITY else min(most, hard), hard))
    try:
        yield
    except MemoryError:
        raise MemoryError(f"it needed more than {megabytes:g} MB, the memory limit") from None
    finally:
        resource.setrlimit(resource.RLIMIT_DATA, (soft, hard))


def pack(values: Mapping[str, Any], arrays: Mapping[str, Any]) -> bytes:
    """Plain values and arrays as the bytes of an ``npz`` file."""
    file = io.BytesIO()
    header = np.frombuffer(json.dumps(values).encode(), np.uint8)
    np.savez(file, **{**arrays, _HEADER: header})
    return file.getvalue()


def unpack(data: bytes) -> tuple[dict[str, Any], dict[str, Any]]:
    """The values and arrays of :func:`pack`; nothing is unpickled. Arrays of shape ``()`` become scalars.

    Raises:
        ValueError: an array holds objects.
    """
    with np.load(io.BytesIO(data), allow_pickle=False) as file:
        arrays = {name: file[name][()] for name in file.files}
    return json.loads(arrays.pop(_HEADER).tobytes()), arrays
