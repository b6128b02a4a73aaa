"""What a result was made with: versions and the machine, without anybody's name or path."""

from __future__ import annotations

import os
import platform
from collections.abc import Iterable
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

__all__ = ["machine", "versions"]

_PACKAGES = ("usnet", "numpy", "scipy", "scikit-learn", "numba", "gymnasium")


def versions(more: Iterable[str] = ()) -> dict[str, str]:
    """Versions of Python and of the packages that numbers depend on.

    Args:
        more: further packages; those that are not installed are left out.
    """
    found = {"python": platform.python_version()}
    for package in (*_PACKAGES, *more):
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            if package not in more:  # a source tree on the path without an installation
                found[package] = "unknown"
    return found


def machine() -> dict[str, Any]:
    """The machine without its name: what seconds depend on."""
    return {"cpu": _processor(), "cores": os.cpu_count(), "platform": f"{platform.system()} {platform.machine()}"}


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()
