"""The versions and the machine of a result, without names or paths of users."""

from __future__ import annotations

import os
import platform
from collections.abc import Iterable
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

_PACKAGES = ("usnet", "numpy", "scipy", "scikit-learn", "numba", "gymnasium")


def versions(more: Iterable[str] = ()) -> dict[str, str]:
    """Versions of Python and of the packages that results depend on.

    Args:
        more: names of further packages; packages that are not installed are omitted.
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
    """The processor, the number of cores and the platform, on which run times depend."""
    return {"cpu": _processor(), "cores": os.cpu_count(), "platform": f"{platform.system()} {platform.machine()}"}


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()
