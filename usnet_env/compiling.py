"""Compiles loops with Numba, and keeps the machine code on disk if a folder for it can be written."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

from numba import njit

__all__ = ["compiled"]

Loop = TypeVar("Loop", bound=Callable[..., Any])


def compiled(**options: Any) -> Callable[[Loop], Loop]:
    """A decorator that compiles a function at its first call.

    Numba keeps machine code beside the source or in the user's cache folder. Where it can write neither, the function
    is compiled again in every process.

    Args:
        options: further arguments of :func:`numba.njit`.
    """

    def compile_function(function: Loop) -> Loop:
        try:
            loop: Loop = njit(cache=True, nogil=True, **options)(function)
        except RuntimeError as error:
            if "no locator available" not in str(error):
                raise
            loop = njit(nogil=True, **options)(function)
        return loop

    return compile_function
