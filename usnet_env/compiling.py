"""Compiles loops with Numba, and keeps the machine code on disk if a folder for it can be written."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import njit

__all__ = ["compiled"]


def compiled(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Return a decorator that compiles a function at its first call.

    Numba keeps machine code beside the source or in the user's cache folder. Where it can write neither, the function
    is compiled again in every process.

    Args:
        options: further arguments of :func:`numba.njit`.
    """

    def compile_function(function: Callable[..., Any]) -> Any:
        try:
            return njit(cache=True, nogil=True, **options)(function)
        except RuntimeError as error:
            if "no locator available" not in str(error):
                raise
            return njit(nogil=True, **options)(function)

    return compile_function
