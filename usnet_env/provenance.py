"""The versions and the machine of a result, without names or paths of users."""

from __future__ import annotations

import os
import platform
from collections.abc import Iterable
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from typing import Any

_PACKAGES = ("usnet", "numpy", "scipy", "scikit-learn", "numba", "gymnasium")


def versions(more: Iterable[str] = ()) -> dict[str, str]:
    """Versions of Python, the packages that results depend on and others; those not installed are omitted."""
    found = {"python": platform.python_version()}
    for package in (*_PACKAGES, *more):
        with suppress(PackageNotFoundError):
            found[package] = version(package)
    return found


def machine() -> dict[str, Any]:
    """The processor, the number of cores and the platform, on which run times depend."""
    cpu = platform.processor() or platform.machine()
    return {"cpu": cpu, "cores": os.cpu_count(), "platform": f"{platform.system()} {platform.machine()}"}
