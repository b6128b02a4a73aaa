"""Limits of time and memory for the parts of a task that runs in a child process."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Annotated, Any

from pydantic import Field

from usnet_env.config import ArgumentError, Config

_MEGABYTE = 1_000_000


class Limits(Config):
    """Limits of each part of a task that :func:`limited` marks.

    Args:
        seconds: wall time; ``None``: no limit. A process that exceeds it is killed.
        megabytes: memory in 10^6 bytes that the process may allocate beyond what it holds when the part begins;
            ``None``: no limit. Beyond it, allocations fail: in Python with ``MemoryError``. Linux only.

    Raises:
        ArgumentError: a limit is not a positive number up to 1e9, or this system cannot limit memory.
    """

    seconds: Annotated[float, Field(ge=1e-3, le=1e9)] | None = None
    megabytes: Annotated[float, Field(gt=0, le=1e9)] | None = None

    def __init__(self, **values: Any) -> None:
        super().__init__(**values)
        if self.megabytes is not None and not sys.platform.startswith("linux"):
            raise ArgumentError(f"megabytes must be None on a system other than Linux, got {self.megabytes:g}.")

    @property
    def any(self) -> bool:
        """Whether there is a limit."""
        return self.seconds is not None or self.megabytes is not None


class ProcessDied(RuntimeError):
    """A child process ended, or was killed, before it finished a task.

    Args:
        reason: why, as the second half of a sentence without its full stop: ``"its process ended itself with status
            0"``.
        during: what the process had marked last with :func:`limited` if it was inside, else ``None``.
    """

    def __init__(self, reason: str, during: str | None = None) -> None:
        super().__init__(reason, during)
        self.reason = reason
        self.during = during

    def __str__(self) -> str:
        return f"{self.reason}, in {self.during}" if self.during else self.reason


@dataclass
class _Child:
    """This process, if it is a child of a pool: what reports to the parent, and the limits."""

    send: Callable[..., None]
    limits: Limits
    pid: int = field(default_factory=os.getpid)
    inside: bool = False


_child: _Child | None = None


def apply_limits(limits: Limits, send: Callable[..., None]) -> None:
    """Apply the limits in this child process to what :func:`limited` marks.

    Args:
        limits: the limits.
        send: sends its arguments to the parent, which measures the time: ``"begin"`` and the part's name, ``"end"``.
    """
    global _child
    _child = _Child(send, limits)


@contextmanager
def limited(what: str) -> Iterator[None]:
    """Mark a part of a task to which the limits of the pool apply; outside a pool it does nothing.

    Parts do not nest: inside another part it does nothing.

    Args:
        what: a name of the part for reasons, such as ``"episode 3, round 1"``.

    Raises:
        MemoryError: the part needed more memory than its limit.
    """
    child = _child
    if child is None or child.inside or not child.limits.any:
        yield
        return
    child.inside = True
    if child.limits.seconds is not None:
        child.send("begin", what)
    try:
        with limit_memory(child.limits.megabytes):
            yield
    finally:
        if os.getpid() != child.pid:  # a copy of the process, made by os.fork inside the part, must not go on as well
            os._exit(1)
        child.inside = False
        if child.limits.seconds is not None:
            child.send("end")


@contextmanager
def limit_memory(megabytes: float | None) -> Iterator[None]:
    """Limit what this process may allocate in the block beyond what it holds; ``None``: no limit.

    Raises:
        MemoryError: the block needed more.
    """
    if megabytes is None:
        yield
        return
    import resource

    before = resource.getrlimit(resource.RLIMIT_DATA)
    with open("/proc/self/statm", "rb") as file:
        held = int(file.read().split()[5]) * resource.getpagesize()
    most = held + int(megabytes * _MEGABYTE)
    if before[1] != resource.RLIM_INFINITY:
        most = min(most, before[1])
    resource.setrlimit(resource.RLIMIT_DATA, (most, before[1]))
    try:
        yield
    except MemoryError:
        raise MemoryError(f"it needed more than {megabytes:g} MB, the memory limit") from None
    finally:
        resource.setrlimit(resource.RLIMIT_DATA, before)
