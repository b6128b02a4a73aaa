"""Compiles loops with Numba, and keeps the machine code on disk if a folder for it can be written."""

from __future__ import annotations

import gc
import os
import signal
import threading
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from typing import Any

import numpy as np

try:
    import fcntl
except ImportError:  # Windows has no such locks
    fcntl = None  # type: ignore[assignment]  # a missing module

_held_locks: set[str] = set()  # the lock files that this process holds
_ANNOUNCE_AFTER = 1.0  # seconds: loading machine code from the disk is faster
_announcers: list[Callable[[str], None]] = []  # what tells a person, once, that it takes long


def tell_if_long(announce: Callable[[str], None]) -> None:
    """Call ``announce`` with a sentence when a function takes long to compile; later ones are compiled silently."""
    _announcers[:] = [announce]


def _announce_compilation() -> None:
    while _announcers:
        _announcers.pop()("compiling loops for this machine; it keeps them, so the next start is faster …")


def compiled(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Return a decorator that compiles a function at its first call; ``options`` are those of :func:`numba.njit`.

    With ``inner=True`` it may be called by compiled functions only, and compiles faster. With ``_nrt=False`` it
    makes no arrays, and counts no references to arrays, which takes longer than a short loop. A change of the function,
    or of a function or a number that it uses, in any file, compiles it again. Where no folder can be written, it is
    compiled again in every process. Of several processes that need the same code, one compiles it, and the others wait
    and load it (except on Windows): Numba's own cache mixes up the code of two processes that compile different
    signatures of one function at the same time.
    """
    from numba import njit  # it takes a quarter of a second, also where nothing is compiled

    # They are always given: Numba compiles a function without options by those of its first caller.
    options = {"fastmath": False, "error_model": "python", "_nrt": True, **options}
    # Each wrapper holds the loop's machine code again: one for callers in C, which are none, and one for Python.
    options |= {"no_cfunc_wrapper": True, "no_cpython_wrapper": options.pop("inner", False)}

    def compile_function(function: Callable[..., Any]) -> Any:
        loop = njit(nogil=True, **options)(function)
        if loop is function:  # NUMBA_DISABLE_JIT
            return function
        try:
            loop._cache = _make_cache_class()(function)
        except RuntimeError as error:
            if "no locator available" not in str(error):
                raise
            return loop
        lock = os.path.join(loop.stats.cache_path, f".{function.__module__}.{function.__qualname__}.lock")
        compile_signature = loop.compile

        def compile_alone(signature: Any) -> Any:
            timer = threading.Timer(_ANNOUNCE_AFTER, _announce_compilation) if _announcers else None
            if timer is not None:
                timer.daemon = True
                timer.start()
            try:
                with _hold_lock(lock), _undisturbed():
                    return compile_signature(signature)
            finally:
                if timer is not None:
                    timer.cancel()

        loop.compile = compile_alone
        return loop

    return compile_function


@cache
def _make_cache_class() -> Any:
    """The class of caches; a function, because importing Numba takes long."""
    from numba.core.caching import FunctionCache

    class Cache(FunctionCache):
        """It notices changes in other files too, and takes a damaged file or a full disk for an empty folder."""

        def __init__(self, function: Any) -> None:
            super().__init__(function)  # type: ignore[no-untyped-call]
            self.stamp = self._cache_file._source_stamp  # of the function's file

        def load_overload(self, signature: Any, target: Any) -> Any:
            self._cache_file._source_stamp = _find_stamps(self, {})
            try:
                return super().load_overload(signature, target)  # type: ignore[no-untyped-call]
            except Exception:  # unpickling a file that was not written to its end may raise anything
                return self._forget()

        def save_overload(self, signature: Any, code: Any) -> None:
            try:
                super().save_overload(signature, code)  # type: ignore[no-untyped-call]
            except OSError as error:
                self._forget()  # it may name code that was not written
                _warn_once(f"can't keep machine code in {self.cache_path}: {error.strerror}.")

        def _forget(self) -> None:
            with suppress(OSError):
                os.unlink(self._cache_file._index_path)

    return Cache


@cache
def _warn_once(sentence: str) -> None:
    warnings.warn(sentence, stacklevel=1)


def _find_stamps(cache: Any, stamps: dict[str, Any]) -> dict[str, Any]:
    """Collect the stamps of a function's file and of those of all that it calls, and the constants that they use."""
    function = cache._py_func
    stamps[f"{function.__module__}.{function.__qualname__}"] = cache.stamp
    for name in function.__code__.co_names:
        value = function.__globals__.get(name)
        callee_cache = getattr(value, "_cache", None)
        if hasattr(callee_cache, "stamp"):
            if f"{value.__module__}.{value.__qualname__}" not in stamps:
                _find_stamps(callee_cache, stamps)
        elif isinstance(value, int | float | tuple | np.generic | np.ndarray):
            stamps[f"{function.__module__}:{name}"] = repr(value)
    return stamps


@contextmanager
def _undisturbed() -> Iterator[None]:
    """No search for garbage, which takes a seventh of the time; and Ctrl-C waits: in a callback of LLVM it is lost."""
    pressed, was_enabled, handler = list[int](), gc.isenabled(), None
    if threading.current_thread() is threading.main_thread():
        handler = signal.signal(signal.SIGINT, lambda number, _: pressed.append(number))
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()
        if handler is not None:
            signal.signal(signal.SIGINT, handler)
        if pressed:
            signal.raise_signal(signal.SIGINT)


@contextmanager
def _hold_lock(lock: str) -> Iterator[None]:
    """Hold a lock file; without locks, where it cannot be written, or if this process holds it, do nothing.

    Numba's own lock, which lets one thread of a process compile at a time, is taken first: a compilation begins others,
    so that two threads could wait for each other.
    """
    from numba.core.compiler_lock import global_compiler_lock

    with global_compiler_lock:
        if fcntl is None or lock in _held_locks:
            yield
            return
        file = None
        with suppress(OSError):
            os.makedirs(os.path.dirname(lock), exist_ok=True)
            file = os.open(lock, os.O_RDWR | os.O_CREAT, 0o644)
            fcntl.flock(file, fcntl.LOCK_EX)
        _held_locks.add(lock)
        try:
            yield
        finally:
            _held_locks.discard(lock)
            if file is not None:
                fcntl.flock(file, fcntl.LOCK_UN)  # a process that was forked meanwhile would keep it
                os.close(file)
