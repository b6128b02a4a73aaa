"""The contract that every clusterer of UAVs satisfies, and the registry of their names."""

from __future__ import annotations

import inspect
from abc import abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from types import MappingProxyType
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from sklearn.base import BaseEstimator

from detectors.clustering.affinity import AFFINITIES, Affinity, affinity_of
from detectors.clustering.count import COUNTS, eigengap, gap
from detectors.clustering.features import FEATURES, Features, features_of
from usnet_env.config import ArgumentError, Config, quote, unknown_name
from usnet_env.window import Window, frozen_array

__all__ = [
    "Clusterer",
    "ClustererArguments",
    "Clustering",
    "Living",
    "clusterers",
    "make_clusterer",
    "register_clusterer",
]

Floats = NDArray[np.float64]
Labels = NDArray[np.int64]

OWN = "own"  # count= of a clusterer that finds the number of clusters as it clusters


@dataclass(frozen=True, eq=False)
class Clustering:
    """Who belongs together, and why. All arrays are read-only copies.

    Args:
        labels: ``(N,)`` int64, 0 to ``count`` - 1 for the living UAVs, -1 for the destroyed.
        count: number of clusters; 0 where nobody lives.
        features: ``(N, d)`` or ``(N, T, d)``, what was clustered (0 for the destroyed), or ``None``.
        affinity: ``(N, N)``, how much any two UAVs belong together, from 0 to 1 (0 for the destroyed), or ``None``
            where it was not looked at.
        extras: anything else worth keeping, by name: ``"estimate"``, the number of clusters that was asked for or
            estimated before clustering.

    Raises:
        ArgumentError: an array of another shape, or labels other than -1 to ``count`` - 1, each used.
    """

    labels: Labels
    count: int
    features: Floats | None = None
    affinity: Floats | None = None
    extras: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        put = object.__setattr__
        put(self, "labels", frozen_array("labels", self.labels, np.int64, (None,)))
        uavs = len(self.labels)
        used = np.unique(self.labels)
        if not np.array_equal(used[used != -1], np.arange(self.count)):
            raise ArgumentError(
                f"labels must be the numbers 0 to count - 1 = {self.count - 1}, each used, and -1, got {quote(used)}."
            )
        if self.features is not None:
            values = np.asarray(self.features)
            shape = (uavs, None, None) if values.ndim == 3 else (uavs, None)
            put(self, "features", frozen_array("features", values, np.float64, shape))
        if self.affinity is not None:
            put(self, "affinity", frozen_array("affinity", self.affinity, np.float64, (uavs, uavs)))
        put(self, "extras", dict(self.extras))


class ClustererArguments(Config):
    """The arguments that all clusterers have, checked."""

    count: Annotated[int, Field(ge=1)] | str
    features: str | Features
    affinity: str | Affinity | None
    max_lag: Annotated[int, Field(ge=0)]
    memory: Annotated[int, Field(ge=1, le=1000)]


@dataclass(frozen=True, eq=False)
class Living:
    """What the n living UAVs of a window show; computed when it is asked for.

    Args:
        window: the whole window.
        arguments: how to look at it.
    """

    window: Window
    arguments: ClustererArguments

    @cached_property
    def index(self) -> NDArray[np.intp]:
        """``(n,)`` their indices among the N of the window."""
        return np.flatnonzero(self.window.alive)

    @cached_property
    def features(self) -> Floats:
        """``(n, d)``, or a series ``(n, T, d)``."""
        return features_of(self.arguments.features, self.window, self.arguments.memory)[self.index]

    @cached_property
    def flat(self) -> Floats:
        """``(n, d)``: a series is laid out in a row."""
        return self.features.reshape(len(self.index), -1)

    @cached_property
    def affinity(self) -> Floats:
        """``(n, n)`` symmetric, from 0 to 1, 1 on the diagonal."""
        return affinity_of(self.arguments.affinity, self.features, self.arguments.max_lag)


class Clusterer(BaseEstimator):  # type: ignore[misc]  # scikit-learn ships no types
    """Clusters the living UAVs of one window. A subclass writes :meth:`partition`.

    The constructor stores its keyword arguments and nothing else. Windows without a living UAV give no cluster, one
    living UAV is a cluster of its own. Living UAVs that were never seen take part with mean features. A ``count`` above
    the number of living UAVs is lowered to it, and K-Means and SNMF may find fewer clusters than asked for.

    Args:
        count: the number of clusters: a whole number, ``"gap"`` (:func:`detectors.clustering.gap`, on the features),
            ``"gap-one-se"`` (the same by the one-standard-error rule alone) or ``"eigengap"``
            (:func:`detectors.clustering.eigengap`, on the affinity).
        features: what is clustered: ``"raw"``, ``"scaled"``, ``"velocities"``
            (see :mod:`detectors.clustering.features`), or a callable from a window to ``(N, d)`` or ``(N, T, d)``.
        affinity: ``"lag"`` (a series only), ``"rbf"``, ``"cosine"`` (see :mod:`detectors.clustering.affinity`), or a
            callable from the features of n UAVs to ``(n, n)``; ``None``: ``"lag"`` for a series, else ``"rbf"``.
        max_lag: L, the longest lag of ``"lag"`` in samples, at least 0.
        memory: T_0, the samples in ``"raw"`` and ``"scaled"``.

    Raises:
        ArgumentError: from :meth:`cluster`, if an argument is refused.
    """

    counts: tuple[str, ...] = COUNTS  #: the names that ``count`` takes

    def __init__(
        self,
        count: int | str = "eigengap",
        features: str | Features = "velocities",
        affinity: str | Affinity | None = None,
        max_lag: int = 4,
        memory: int = 4,
    ) -> None:
        self.count = count
        self.features = features
        self.affinity = affinity
        self.max_lag = max_lag
        self.memory = memory

    def check_arguments(self) -> ClustererArguments:
        """The common arguments, or ``ArgumentError``. A subclass with arguments of its own checks them as well."""
        common = ClustererArguments(**{name: getattr(self, name) for name in ClustererArguments.model_fields})
        if isinstance(common.count, str) and common.count not in self.counts:
            raise unknown_name("count", common.count, (*self.counts, "a whole number"))
        if isinstance(common.features, str) and common.features not in FEATURES:
            raise unknown_name("features", common.features, FEATURES)
        if isinstance(common.affinity, str) and common.affinity not in AFFINITIES:
            raise unknown_name("affinity", common.affinity, AFFINITIES)
        return common

    def cluster(self, window: Window, rng: np.random.Generator) -> Clustering:
        """Cluster the living UAVs.

        Args:
            window: what the observer saw.
            rng: what is random comes from here.

        Raises:
            ArgumentError: an argument is refused, or a callable of ``features`` or ``affinity`` gave what it can't.
        """
        arguments = self.check_arguments()
        living = Living(window, arguments)
        n = len(living.index)
        labels = np.full(window.uavs, -1, np.int64)
        if n == 0:
            return Clustering(labels, 0)
        if n == 1:
            labels[living.index] = 0
            return Clustering(labels, 1, extras={"estimate": 1})
        estimate = self._estimate(living, rng)
        found = self.partition(living, None if estimate is None else min(estimate, n), rng)
        used, labels[living.index] = np.unique(found, return_inverse=True)
        features = np.zeros((window.uavs, *living.features.shape[1:]))
        features[living.index] = living.features
        affinity = None
        if "affinity" in living.__dict__:  # it was looked at
            affinity = np.zeros((window.uavs, window.uavs))
            affinity[np.ix_(living.index, living.index)] = living.affinity
        extras = {"estimate": len(used) if estimate is None else estimate}
        return Clustering(labels, len(used), features, affinity, extras)

    def _estimate(self, living: Living, rng: np.random.Generator) -> int | None:
        count = living.arguments.count
        if isinstance(count, int):
            return count
        if count == "gap":
            return gap(living.flat, rng).count
        if count == "gap-one-se":
            return gap(living.flat, rng, clear=np.inf).count
        return eigengap(living.affinity, rng) if count == "eigengap" else None

    @abstractmethod
    def partition(self, living: Living, count: int | None, rng: np.random.Generator) -> NDArray[np.integer[Any]]:
        """Labels ``(n,)`` of the n >= 2 living UAVs, any whole numbers.

        Args:
            living: features and affinity.
            count: the number of clusters, 1 to n; ``None`` (with ``count="own"`` only): for the clusterer to find.
            rng: what is random comes from here.
        """


_CLUSTERERS: dict[str, Callable[..., Clusterer]] = {}


def clusterers() -> Mapping[str, Callable[..., Clusterer]]:
    """All registered clusterers by name (a read-only view)."""
    return MappingProxyType(_CLUSTERERS)


def register_clusterer(name: str, factory: Callable[..., Clusterer]) -> None:
    """Make a clusterer of one's own available under ``name``.

    Args:
        name: a name that is taken by another clusterer is refused.
        factory: a class, or a function, that gives an object with ``cluster(window, rng)`` when it is called with
            keyword arguments.

    Raises:
        ArgumentError: the name is taken or not a name, or the factory can't be called.
    """
    if not isinstance(name, str) or not name.strip():
        raise ArgumentError(f"name must be a non-empty name, got {quote(name)}.")
    if not callable(factory):
        raise ArgumentError(f"factory must be a class or a function that makes a clusterer, got {quote(factory)}.")
    if _CLUSTERERS.get(name, factory) is not factory:
        raise ArgumentError(f"name must be a new one, got {name!r}, which is registered already.")
    _CLUSTERERS[name] = factory


def make_clusterer(name: str, /, **arguments: Any) -> Clusterer:
    """The clusterer registered under ``name``: ``make_clusterer("spectral", count="eigengap")``.

    Args:
        name: see :func:`clusterers`.
        arguments: of its constructor.

    Raises:
        ArgumentError: no such clusterer, or an argument that it does not have.
    """
    if name not in _CLUSTERERS:
        raise unknown_name("clusterer", name, _CLUSTERERS)
    factory = _CLUSTERERS[name]
    known = inspect.signature(factory).parameters
    takes_any = any(parameter.kind is parameter.VAR_KEYWORD for parameter in known.values())
    for argument in arguments:
        if argument not in known and not takes_any:
            raise ArgumentError(f"clusterer {name!r} has no argument {argument!r}; it takes {', '.join(known)}.")
    return factory(**arguments)
