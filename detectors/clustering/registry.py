"""The registry of the clusterers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from detectors.clustering.base import Clusterer
from detectors.clustering.partitions import Agglomerative, Hdbscan, KMeans, LeadVotes, Spectral, SymmetricNMF
from usnet_env.config import ArgumentError, quote
from usnet_env.parts import Registry, check_call

Factory = Callable[..., Clusterer]


def _check_factory(factory: Any, subject: str = "factory") -> Factory:
    if not callable(factory):
        raise ArgumentError(f"{subject} must be a class or a function that returns a clusterer, got {quote(factory)}.")
    return factory


_OWN: dict[str, Factory] = {
    "kmeans": KMeans,
    "spectral": Spectral,
    "snmf": SymmetricNMF,
    "agglomerative": Agglomerative,
    "hdbscan": Hdbscan,
    "lead-votes": LeadVotes,
}

#: All clusterers by name.
CLUSTERERS = Registry("clusterer", "clusterer", "usnet.clusterers", __name__, _check_factory, _OWN, classes=True)


def clusterers() -> Mapping[str, Factory]:
    """Return all clusterers by name (a read-only view)."""
    return CLUSTERERS


def register_clusterer(name: str, factory: Factory, *, replace: bool = False) -> None:
    """Register a clusterer under ``name``.

    Args:
        name: a new name.
        factory: a class or a function that takes keyword arguments and returns an object with
            ``cluster(window, rng)``.
        replace: replace another clusterer of this name, for example to run a notebook cell again. The clusterers of
            this package can't be replaced.

    Raises:
        ArgumentError: the name belongs to another clusterer or is not a string, or the factory is not callable.
    """
    CLUSTERERS.register(name, factory, replace=replace)


def make_clusterer(name: str, /, **arguments: Any) -> Clusterer:
    """Create the clusterer of this name: ``make_clusterer("spectral", count="eigengap")``.

    Args:
        name: a name of :func:`clusterers`.
        arguments: keyword arguments of its constructor.

    Raises:
        ArgumentError: there is no such clusterer, or it does not take such an argument.
    """
    factory = CLUSTERERS.find(name)
    check_call(f"clusterer {name!r}", factory, arguments)
    return factory(**arguments)


def check_clusterer(clusterer: Any) -> None:
    """Refuse what is neither the name of a clusterer nor an object with ``cluster(window, rng)``."""
    if isinstance(clusterer, str):
        CLUSTERERS.find(clusterer)
    elif not callable(getattr(clusterer, "cluster", None)):
        raise ArgumentError(f"clusterer must be a name or have cluster(window, rng), got {quote(clusterer)}.")
