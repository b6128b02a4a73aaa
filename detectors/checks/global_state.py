"""Checks that a detector leaves its input and the state of the process unchanged, and keeps the time budget."""

from __future__ import annotations

import builtins
import os
import signal
import sys
import threading
import time
import types
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from multiprocessing import resource_tracker
from pathlib import Path
from typing import Any

import numpy as np
from sklearn.base import clone
from threadpoolctl import threadpool_info  # type: ignore[import-untyped]

from detectors.checks.harness import calling, copy_detector, play_batch, play_windows, require, warn
from detectors.checks.windows import draw_two_rounds, draw_window

_SIGNALS = [number for number in signal.valid_signals() if isinstance(number, signal.Signals)]
_VARIABLE = "environment variable "
_UNUSUAL_SEED = 2_718_281_828
GRACE = 0.5  # seconds in which all threads may end after an answer
SECONDS = 10.0  # for a window of the paper's size: N = 82, T_ob = 100
_WATCHED_PACKAGES = ("usnet_env", "gymnasium", "detectors")  # with all their modules
_WATCHED_MODULES = ("numpy", "numpy.random")
_METHODS = (types.FunctionType, types.BuiltinFunctionType, property, staticmethod, classmethod)
_PROC = Path("/proc/self")


def check_input_unchanged(detector: Any) -> None:
    """After ``detect`` the window holds the same arrays with the same values, and they are still read-only."""
    window = draw_window(detector, miss_rate=0.1, destroyed=2, round=2)
    arrays = {name: (value, value.tobytes()) for name, value in vars(window).items() if isinstance(value, np.ndarray)}
    play_windows(copy_detector(detector), [window])
    for name, (array, content) in arrays.items():
        same = getattr(window, name) is array and array.tobytes() == content and not array.flags.writeable
        require(same, f"detect must leave the window unchanged, got another {name}.")
    require(window.round == 2, f"detect must leave the window unchanged, got round {window.round!r}.")


def check_global_generators_untouched(detector: Any) -> None:
    """The detector neither seeds nor draws from the global generators of Python, NumPy and PyTorch (if imported)."""
    changed: list[str] = []
    imported = -1
    while not changed and imported != (imported := len(sys.modules)):  # a call may import what the next one uses
        with _reseed_global_generators():
            changed = _find_changes(detector, _read_generator_states)
    require(
        not changed,
        f"a detector must draw from its own generator, got a change of the global one of {', '.join(changed)}.",
    )


def check_process_settings_untouched(detector: Any, functions: Mapping[str, tuple[Any, ...]] | None = None) -> None:
    """The detector leaves the process as it was, and nothing of it goes on after the answer.

    Settings: thread counts (BLAS, OpenMP, Numba, PyTorch), NumPy's error handling, PyTorch's defaults, environment
    variables, signal handlers and the current folder. Code: the functions and classes of usnet_env, detectors,
    Gymnasium and NumPy. Left behind: threads, processes and open files. A daemon thread is a warning only.
    ``functions`` is the result of :func:`list_functions` before the detector was imported.
    """
    functions = list_functions() if functions is None else functions
    threads, processes = set(threading.enumerate()), list_processes()
    variables = set(os.environ)
    changed = _find_changes(detector, _read_process_settings)
    # The first call may import a library that sets variables. Only the detector itself sets them in the second as well.
    added = {name: os.environ.pop(name) for name in set(os.environ) - variables}
    files = list_files()
    changed = changed or _find_changes(detector, _read_process_settings, new=_VARIABLE)
    os.environ.update(added)
    after = list_functions()
    changed += [name for name, parts in functions.items() if [*map(id, after.get(name, ()))] != [*map(id, parts)]]
    require(
        not changed,
        "a detector must leave the settings and the libraries of the process unchanged, got a change of "
        f"{', '.join(changed)}.",
    )
    left = [name for pid, name in list_processes().items() if pid not in processes]
    left += [name for number, name in list_files().items() if number not in files]
    daemons, end = [], time.monotonic() + GRACE
    for thread in set(threading.enumerate()) - threads:
        with suppress(RuntimeError, AssertionError):  # a thread that was not started by Python
            thread.join(max(0.0, end - time.monotonic()))
        if thread.is_alive() and thread.daemon:
            daemons.append(f"thread {thread.name!r}")
        elif thread.is_alive():
            left.append(f"thread {thread.name!r}, which is not a daemon")
    require(not left, f"a detector must leave nothing behind when it has answered, got {', '.join(left[:4])}.")
    if daemons:
        warn(f"a detector should leave no thread running when it has answered, got {', '.join(daemons[:4])}.")


def check_time_budget(detector: Any, seconds: float = SECONDS) -> None:
    """``detect`` takes at most ``seconds`` for 82 UAVs and T_ob = 100.

    The fastest of three calls counts: the first may compile or load something, and another process may slow down one.
    """
    own, window = copy_detector(detector), draw_window(detector, clusters=5, uavs=82, observation_steps=100)
    best = np.inf
    for _ in range(3):
        begin = time.perf_counter()
        play_windows(own, [window])
        best = min(best, time.perf_counter() - begin)
        if best <= seconds:
            return
    require(False, f"detect must take at most {seconds:g} s for 82 UAVs, got {best:.3g} s.")


def _find_changes(detector: Any, state: Callable[[], dict[str, Any]], new: str | None = None) -> list[str]:
    """Names of the entries of ``state()`` that the detector changes, and new ones if their names start with ``new``."""
    before = state()
    with suppress(Exception), calling("its clone"):  # check_parameters_and_clone reports it
        clone(detector)
    own, windows = copy_detector(detector), draw_two_rounds(detector)
    play_windows(own, windows)
    if callable(getattr(own, "detect_batch", None)):
        play_batch(own, windows)
    after = state()
    names = [name for name in before if name in after or name.startswith(_VARIABLE)]
    names += [name for name in after if new and name not in before and name.startswith(new)]
    return [name for name in names if after.get(name) != before.get(name)]


@contextmanager
def _reseed_global_generators() -> Iterator[None]:
    """Seed the global generators with a number that no detector is likely to use; restore their states at the end."""
    numpy, python, torch = sys.modules["numpy.random"], sys.modules["random"], sys.modules.get("torch")
    kept = numpy.get_state(), python.getstate(), torch.get_rng_state() if torch else None
    numpy.seed(_UNUSUAL_SEED)
    python.seed(_UNUSUAL_SEED)
    if torch:
        torch.default_generator.manual_seed(_UNUSUAL_SEED)
    try:
        yield
    finally:
        numpy.set_state(kept[0])
        python.setstate(kept[1])
        if torch:
            torch.set_rng_state(kept[2])


def _read_generator_states() -> dict[str, Any]:
    """Read the states of the global generators of all imported libraries."""
    kind, keys, *rest = sys.modules["numpy.random"].get_state()
    states: dict[str, Any] = {"numpy.random": (kind, keys.tobytes(), rest), "random": sys.modules["random"].getstate()}
    if torch := sys.modules.get("torch"):
        states["torch"] = torch.get_rng_state().numpy().tobytes()
        if torch.cuda.is_initialized():
            states["torch.cuda"] = [state.numpy().tobytes() for state in torch.cuda.get_rng_state_all()]
    return states


def _read_process_settings() -> dict[str, Any]:
    """Read the settings of the process. A library that is imported later adds entries for its own thread pools."""
    values: dict[str, Any] = {f"threads of {pool['filepath']}": pool["num_threads"] for pool in threadpool_info()}
    values |= {f"{_VARIABLE}{name}": value for name, value in os.environ.items()}
    if threading.current_thread() is threading.main_thread():
        values |= {f"handler of {signal.Signals(number).name}": signal.getsignal(number) for number in _SIGNALS}
    values["current folder"] = os.getcwd()
    values["numpy.geterr"] = np.geterr()
    if numba := sys.modules.get("numba"):
        # get_num_threads starts Numba's threads, which changes those of OpenMP. Before that, the default holds.
        parallel = sys.modules.get("numba.np.ufunc.parallel")
        running = parallel is not None and getattr(parallel, "_is_initialized", False)
        values["threads of numba"] = numba.get_num_threads() if running else numba.config.NUMBA_NUM_THREADS
    if torch := sys.modules.get("torch"):
        values["threads of torch"] = torch.get_num_threads()
        values["torch.get_default_dtype"] = torch.get_default_dtype()
        values["torch.is_grad_enabled"] = torch.is_grad_enabled()
        values["torch.are_deterministic_algorithms_enabled"] = torch.are_deterministic_algorithms_enabled()
    return values


def list_functions() -> dict[str, tuple[Any, ...]]:
    """List the code that scores detectors: all functions, classes and methods of the watched modules, by name."""
    found: dict[str, tuple[Any, ...]] = {}
    for name, module in list(sys.modules.items()):
        inside = name in _WATCHED_MODULES or any(name == top or name.startswith(f"{top}.") for top in _WATCHED_PACKAGES)
        if inside and isinstance(module, types.ModuleType):
            _list_members(found, name, vars(module))
    _list_members(found, "builtins", vars(builtins))
    return found


def _list_members(found: dict[str, tuple[Any, ...]], path: str, members: Any) -> None:
    for key, value in list(members.items()):
        name = f"{path}.{key}"
        if isinstance(value, type):
            found[name] = (value,)
            if value.__module__ == path:
                methods = {key: method for key, method in vars(value).items() if isinstance(method, _METHODS)}
                _list_members(found, name, methods)
        elif isinstance(value, types.FunctionType):
            found[name] = (value, value.__code__, value.__defaults__)
        elif isinstance(value, _METHODS) or callable(value):
            found[name] = (value,)


def list_processes() -> dict[int, str]:
    """List the child processes of this process, dead ones included that were not waited for; Linux only."""
    found: dict[int, str] = {}
    tracker = getattr(getattr(resource_tracker, "_resource_tracker", None), "_pid", None)
    for children in _PROC.glob("task/*/children"):
        with suppress(OSError):
            for pid in map(int, children.read_text().split()):
                if pid != tracker:  # multiprocessing starts one process for itself
                    command = "ended"
                    with suppress(OSError):
                        command = Path(f"/proc/{pid}/comm").read_text().strip()
                    found[pid] = f"process {pid} ({command})"
    return found


def list_files() -> dict[int, str]:
    """List the open files, pipes and sockets of this process by their numbers; Linux only."""
    found: dict[int, str] = {}
    with suppress(OSError):
        for number in os.listdir(_PROC / "fd"):
            with suppress(OSError):  # the one that lists them is closed by now
                found[int(number)] = f"open file {os.readlink(_PROC / 'fd' / number)}"
    return found
