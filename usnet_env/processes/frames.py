"""Find the line of foreign code in which an exception was raised."""

from __future__ import annotations

import functools
import sysconfig
import traceback
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

_INSTALLED = {"site-packages", "dist-packages"}
_PYTHON = tuple(sysconfig.get_paths()[name] for name in ("stdlib", "platstdlib"))
_PACKAGE = Path(__file__).parents[1]


@functools.lru_cache(maxsize=4096)
def is_installed(path: str) -> bool:
    """Whether a file is one of Python or of an installed distribution."""
    return not _INSTALLED.isdisjoint(Path(path).parts) or path.startswith(_PYTHON)


def _is_generated(filename: str, variables: Mapping[str, Any]) -> bool:
    """Whether code has no line in any file although its module has a file: Python generated it, or froze it.

    The ``__init__`` of a dataclass is such code. What a user types at a prompt has no file either, but its module has
    none.
    """
    return filename.startswith("<frozen ") or (filename.startswith("<") and "__file__" in variables)


def find_frame(error: BaseException, hidden: Collection[Path] = (_PACKAGE,)) -> traceback.FrameSummary | None:
    """The last line of a traceback that is not installed; if all are, the last one that is not hidden.

    Args:
        error: the exception.
        hidden: folders and files that do not count; by default this package.

    Returns:
        The line; ``None`` if only hidden code and Python itself raised the exception.
    """
    walked = list(traceback.walk_tb(error.__traceback__))
    outside = [
        summary
        for (frame, _), summary in zip(walked, traceback.extract_tb(error.__traceback__), strict=True)
        if not {Path(summary.filename), *Path(summary.filename).parents} & set(hidden)
        and not _is_generated(summary.filename, frame.f_globals)
    ]
    own = [frame for frame in outside if not is_installed(frame.filename)]
    installed = [frame for frame in outside if not _INSTALLED.isdisjoint(Path(frame.filename).parts)]
    chosen = own or installed
    return chosen[-1] if chosen else None


def describe_place(error: BaseException) -> str:
    """File, line and function of the code outside this package that raised an exception; empty if there is none.

    The file has no folder: sentences hold no places of a machine. An exception that stands for one of another process
    has it as its cause, and the cause knows the place.
    """
    frame = find_frame(error)
    if frame is None:
        place = getattr(error.__cause__, "place", "")
        return place if isinstance(place, str) else ""
    return f"{Path(frame.filename).name}, line {frame.lineno}, in {frame.name}"
