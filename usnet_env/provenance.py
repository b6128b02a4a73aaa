"""The versions and the machine of a result, without names or paths of users."""

from __future__ import annotations

import os
import platform
from collections.abc import Iterable
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from typing import Any

_PACKAGES = ("usnet", "numpy", "scipy", "scikit-learn", "numba", "gymnasium")


def versions(packages: Iterable[str] = ()) -> dict[str, str]:
    """Versions of Python, the packages that results depend on and others; those not installed are omitted."""
    installed = {"python": platform.python_version()}
    for package in (*_PACKAGES, *packages):
        with suppress(PackageNotFoundError):
            installed[package] = version(package)
    return installed


def machine() -> dict[str, Any]:
    """The processor, the number of cores and the platform, on which run times depend."""
    cpu = platform.processor() or platform.machine()
    return {"cpu": cpu, "cores": os.cpu_count(), "platform": f"{platform.system()} {platform.machine()}"}
