"""Simulated UAV swarms, environments in which a detector must find the cluster heads, and their evaluation.

Importing this package registers the environments with Gymnasium.
"""

from __future__ import annotations

from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING, Any

from usnet_env.config import ArgumentError
from usnet_env.detection import Detection
from usnet_env.registration import register_environments
from usnet_env.window import Window

if TYPE_CHECKING:
    from usnet_env.drawing import plot_detection
    from usnet_env.evaluation import evaluate, results
    from usnet_env.plugins import make_detector, register_detector
    from usnet_env.swarm import register_follow_strategy, register_mobility
    from usnet_env.tracks import Tracks, find_leaders, read_tracks

try:
    __version__ = version("usnet")
except PackageNotFoundError:  # a source tree on the path without an installation
    __version__ = "0+unknown"

__all__ = ["ArgumentError", "Detection", "Window", "__version__", "evaluate", "make_detector"]
__all__ += ["Tracks", "find_leaders", "plot_detection", "read_tracks", "results"]
__all__ += ["register_detector", "register_follow_strategy", "register_mobility"]

register_environments()


_LAZY_MODULES = {"plot_detection": "drawing", **dict.fromkeys(("evaluate", "results"), "evaluation")}
_LAZY_MODULES |= dict.fromkeys(("make_detector", "register_detector"), "plugins")
_LAZY_MODULES |= dict.fromkeys(("Tracks", "find_leaders", "read_tracks"), "tracks")
_LAZY_MODULES |= dict.fromkeys(("register_follow_strategy", "register_mobility"), "swarm")


def __getattr__(name: str) -> Any:  # these import Numba, SciPy or tables, which not every user needs
    if name in _LAZY_MODULES:
        return getattr(import_module(f"usnet_env.{_LAZY_MODULES[name]}"), name)
    if name in ("envs", "swarm"):
        return import_module(f"usnet_env.{name}")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
