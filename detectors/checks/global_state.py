"""Checks that a detector leaves its input and the state of the process unchanged, and keeps the time budget."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

import numpy as np
from sklearn.base import clone
from threadpoolctl import threadpool_info  # type: ignore[import-untyped]

from detectors.checks.harness import SEED, copy_detector, play_windows, require
from detectors.checks.windows import simulate_window
from usnet_env.window import Window

__all__ = [
    "check_global_generators_untouched",
    "check_input_unchanged",
    "check_process_settings_untouched",
    "check_time_budget",
]

_UNUSUAL_SEED = 2_718_281_828
SECONDS = 10.0  # for a window of the paper's size: N = 82, T_ob = 100


def check_input_unchanged(detector: Any) -> None:
    """After ``detect`` the window holds the same arrays with the same values, and they are still read-only."""
    window = simulate_window(miss_rate=0.1, destroyed=2, round=2)
    arrays = {name: (value, value.tobytes()) for name, value in vars(window).items() if isinstance(value, np.ndarray)}
    play_windows(copy_detector(detector), [window])
    for name, (array, content) in arrays.items():
        same = getattr(window, name) is array and array.tobytes() == content and not array.flags.writeable
        require(same, f"detect must leave the window unchanged, got another {name}.")
    require(window.round == 2, f"detect must leave the window unchanged, got round {window.round!r}.")


def check_global_generators_untouched(detector: Any) -> None:
    """The detector neither seeds nor draws from the global generators of Python, NumPy and PyTorch (if imported)."""
    changed = ""
    for _ in range(2):  # the first call may import what the second uses
        with _reseed_global_generators():
            changed = changed or _find_changes(detector, _read_generator_states)
    require(
        not changed,
        f"a detector must draw from its own generator, got a change of the global one of {changed}.",
    )


def check_process_settings_untouched(detector: Any) -> None:
    """Thread counts (BLAS, OpenMP, Numba, PyTorch), NumPy's error handling and PyTorch's defaults stay unchanged."""
    changed = ""
    for _ in range(2):  # the first call may import what the second uses
        changed = changed or _find_changes(detector, _read_process_settings)
    require(not changed, f"a detector must leave the settings of the process unchanged, got a change of {changed}.")


def check_time_budget(detector: Any, seconds: float = SECONDS) -> None:
    """``detect`` takes at most ``seconds`` for 82 UAVs and T_ob = 100.

    The first call may compile or load something and is not measured.
    """
    own, window = copy_detector(detector), simulate_window(clusters=5, uavs=82, observation_steps=100)
    play_windows(own, [window])
    best = np.inf
    for _ in range(3):  # another process may slow down a single call
        begin = time.perf_counter()
        play_windows(own, [window])
        best = min(best, time.perf_counter() - begin)
        if best <= seconds:
            return
    require(False, f"detect must take at most {seconds:g} s for 82 UAVs, got {best:.3g} s.")


def _find_changes(detector: Any, state: Callable[[], dict[str, Any]]) -> str:
    """Names of the entries of ``state()`` that the detector changes; entries that it adds don't count."""
    before = state()
    _exercise_detector(detector, [simulate_window(), simulate_window(seed=1, destroyed=3, round=2)])
    after = state()
    return ", ".join(name for name in before if after.get(name, before[name]) != before[name])


def _exercise_detector(detector: Any, windows: list[Window]) -> None:
    with suppress(Exception):  # check_parameters_and_clone reports it
        clone(detector)
    own = copy_detector(detector)
    play_windows(own, windows)
    if callable(getattr(own, "detect_batch", None)):
        own.reset(SEED)
        own.detect_batch(windows)


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
