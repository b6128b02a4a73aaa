"""Find the line of foreign code in which an exception was raised."""

from __future__ import annotations

import functools
import sysconfig
import traceback
from collections.abc import Collection
from pathlib import Path

_INSTALLED = {"site-packages", "dist-packages"}
_PYTHON = tuple(sysconfig.get_paths()[name] for name in ("stdlib", "platstdlib"))
_PACKAGE = Path(__file__).parents[1]


@functools.lru_cache(maxsize=4096)
def is_installed(path: str) -> bool:
    """Whether a file is one of Python or of an installed distribution."""
    return not _INSTALLED.isdisjoint(Path(path).parts) or path.startswith(_PYTHON)


def find_frame(error: BaseException, hidden: Collection[Path] = (_PACKAGE,)) -> traceback.FrameSummary | None:
    """The last line of a traceback that is not installed; if all are, the last one that is not hidden.

    Args:
        error: the exception.
        hidden: folders and files that do not count; by default this package.

    Returns:
        The line; ``None`` if only hidden code and Python itself raised the exception.
    """
    outside = [
        frame
        for frame in traceback.extract_tb(error.__traceback__)
        if not {Path(frame.filename), *Path(frame.filename).parents} & set(hidden)
    ]
    own = [frame for frame in outside if not is_installed(frame.filename)]
    installed = [frame for frame in outside if not _INSTALLED.isdisjoint(Path(frame.filename).parts)]
    chosen = own or installed
    return chosen[-1] if chosen else None


def describe_place(error: BaseException) -> str:
    """File, line and function of the code outside this package that raised an exception; empty if there is none.

    The file has no folder: sentences hold no places of a machine.
    """
    frame = find_frame(error)
    return "" if frame is None else f"{Path(frame.filename).name}, line {frame.lineno}, in {frame.name}"
