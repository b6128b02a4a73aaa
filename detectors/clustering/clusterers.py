"""The clusterers: their base class, their result, those of this package and their registry."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from sklearn.cluster import KMeans as SklearnKMeans
from sklearn.cluster import spectral_clustering

from detectors.clustering.counts import estimate_count_by_eigengap, estimate_count_by_gap
from detectors.clustering.features import (
    AFFINITIES,
    FEATURES,
    Affinity,
    Features,
    normalise_affinity,
    regularise_affinity,
)
from detectors.parameters import Count, Lags, Parameters
from detectors.series.votes import scatter_to_swarm
from usnet_env.arrays import Floats, Indices
from usnet_env.parts import Registry, check_call, check_factory
from usnet_env.window import Window

_LEAST_ENTRY = 1e-12  # entry of a factor: the multiplicative update would keep an entry of 0 forever
_TOLERANCE = 1e-5  # the factorisation stops when an update reduces the loss by at most this share


@dataclass(frozen=True, eq=False)
class Clustering:
    """The clusters of one window and what they were computed from."""

    labels: Indices  #: ``(N,)`` int64, 0 to ``count`` - 1 for living UAVs, -1 for destroyed ones
    count: int  #: the number of clusters; 0 if no UAV is alive
    features: Floats | None = None  #: ``(N, d)`` or ``(N, T, d)``, 0 for destroyed UAVs


@dataclass(frozen=True, eq=False)
class Living:
    """Features and affinity of the n living UAVs of a window, computed at first use by a clusterer's arguments."""

    window: Window
    arguments: Any

    @cached_property
    def index(self) -> NDArray[np.intp]:
        """``(n,)`` indices of the living UAVs among the N UAVs of the window."""
        return np.flatnonzero(self.window.alive)

    @cached_property
    def features(self) -> Floats:
        """``(n, d)``, or a time series ``(n, T, d)``."""
        features = self.arguments.features
        if isinstance(features, str):
            return FEATURES[features](self.window, self.arguments.memory)[self.index]
        return np.asarray(features(self.window), np.float64)[self.index]

    @cached_property
    def flat(self) -> Floats:
        """``(n, d)``, or ``(n, T d)``: a time series is flattened to one row per UAV."""
        return self.features.reshape(len(self.index), -1)

    @cached_property
    def affinity(self) -> Floats:
        """``(n, n)`` symmetric, from 0 to 1, 1 on the diagonal."""
        affinity = self.arguments.affinity or ("lag" if self.features.ndim == 3 else "rbf")
        if isinstance(affinity, str):
            return AFFINITIES[affinity](self.features, self.arguments.max_lag)
        values = np.array(affinity(self.features), np.float64)
        np.fill_diagonal(values, 1.0)
        return values


class Clusterer(Parameters):
    """Base class: clusters the living UAVs of one window. A subclass implements :meth:`partition`.

    A living UAV that was never seen has the mean features of the others. K-Means and SNMF may return fewer clusters
    than ``count``, and no clusterer returns more than there are living UAVs.

    Args:
        count: the number of clusters, or how to estimate it: ``"gap"``, the gap statistic of the features, or
            ``"eigengap"``, that of the affinity; see :mod:`detectors.clustering.counts`.
        features: ``"raw"``, ``"scaled"`` or ``"velocities"`` (see :mod:`detectors.clustering.features`), or a callable
            from a window to ``(N, d)`` or a time series ``(N, T, d)``.
        affinity: ``"lag"`` (time series only) or ``"rbf"`` (see :mod:`detectors.clustering.features`), or a callable
            from the features of n UAVs to ``(n, n)``; ``None``: ``"lag"`` for a time series, else ``"rbf"``.
        max_lag: L, the longest lag of ``"lag"``, in samples, at least 0.
        memory: T_0, the number of samples in ``"raw"`` and ``"scaled"``.

    Raises:
        ArgumentError: raised by :meth:`cluster` for an invalid argument.
    """

    count: Count | Literal["gap", "eigengap"] = "eigengap"
    features: Literal["raw", "scaled", "velocities"] | Features = "velocities"
    affinity: Literal["lag", "rbf"] | Affinity | None = None
    max_lag: Annotated[int, Field(ge=0, le=1000)] = 4
    memory: Lags = 4

    def cluster(self, window: Window, rng: np.random.Generator) -> Clustering:
        """Cluster the living UAVs of the observer's window; ``rng`` is the generator of all random numbers."""
        living = Living(window, self.check_arguments())
        n = len(living.index)
        labels = np.full(window.uavs, -1, np.int64)
        if n < 2:
            labels[living.index] = 0
            return Clustering(labels, n)
        partition = self.partition(living, min(self._estimate_count(living, rng), n), rng)
        kept_labels, labels[living.index] = np.unique(partition, return_inverse=True)
        return Clustering(labels, len(kept_labels), scatter_to_swarm(living.features, living.index, window.uavs))

    def _estimate_count(self, living: Living, rng: np.random.Generator) -> int:
        count = living.arguments.count
        if count == "gap":
            return estimate_count_by_gap(living.flat, rng)
        return estimate_count_by_eigengap(living.affinity) if count == "eigengap" else count

    @abstractmethod
    def partition(self, living: Living, count: int, rng: np.random.Generator) -> NDArray[np.integer[Any]]:
        """Assign a label, any whole number, to each of the n ≥ 2 living UAVs, ``(n,)``, for ``count`` clusters."""


class KMeans(Clusterer):
    """K-Means on the features, the best of ten starts; a time series is flattened to one row per UAV."""

    def partition(self, living: Living, count: int, rng: np.random.Generator) -> Indices:
        """Return labels ``(n,)`` by scikit-learn; no more clusters than distinct rows."""
        count = min(count, len(np.unique(living.flat, axis=0)))
        return SklearnKMeans(count, n_init=10, random_state=int(rng.integers(2**31))).fit_predict(living.flat)


class Spectral(Clusterer):
    """Spectral clustering of the regularised affinity."""

    def partition(self, living: Living, count: int, rng: np.random.Generator) -> Indices:
        """Return labels ``(n,)``."""
        if count in (1, len(living.index)):
            return np.arange(len(living.index)) % count
        # K-Means on the embedding sometimes makes a cluster of one head that is similar to no UAV; cluster_qr does not.
        affinity, state = regularise_affinity(living.affinity), int(rng.integers(2**31))
        return spectral_clustering(affinity, n_clusters=count, random_state=state, assign_labels="cluster_qr")


class SymmetricNMF(Clusterer):
    """Symmetric non-negative matrix factorisation of the normalised affinity, A ≈ H Hᵀ (Kuang, Ding, Park, SDM 2012).

    The label of a UAV is the column of the largest entry in its row of H. Of several random ``starts`` with at most
    ``steps`` updates each, the one with the lowest loss is used. The other arguments are those of :class:`Clusterer`.
    """

    starts: Annotated[int, Field(ge=1, le=1_000_000)] = 5
    steps: Annotated[int, Field(ge=1, le=1_000_000)] = 300

    def partition(self, living: Living, count: int, rng: np.random.Generator) -> Indices:
        """Return labels ``(n,)``."""
        matrix = normalise_affinity(living.affinity)
        fits = [factorise_affinity(matrix, count, rng, self.steps) for _ in range(self.starts)]
        return min(fits, key=lambda fit: fit[1][-1])[0].argmax(axis=1).astype(np.int64)


def factorise_affinity(affinity: Floats, rank: int, rng: np.random.Generator, steps: int) -> tuple[Floats, list[float]]:
    """Find a local minimum of |A - H Hᵀ|² over H ≥ 0 from a random start.

    The update is H ← H ∘ (A H / H Hᵀ H)^p. With p = 1/4 it minimises an upper bound of the loss that is equal to the
    loss at H, so the loss never rises. With p = 1/2 it is faster near a minimum, but the loss may rise; such an update
    is used only if the loss does not rise.

    Returns:
        H ``(n, rank)``, and the loss at the start and after every update, at most ``steps``.
    """
    size = float((affinity**2).sum())

    def measure(factor: Floats) -> tuple[Floats, Floats, float]:
        product, gram = affinity @ factor, factor.T @ factor
        return product, gram, max(size - 2.0 * float((factor * product).sum()) + float((gram**2).sum()), 0.0)

    factor = 2.0 * np.sqrt(affinity.mean() / rank) * rng.random((len(affinity), rank)) + _LEAST_ENTRY
    product, gram, loss = measure(factor)
    losses = [loss]
    for _ in range(steps):
        ratio = product / np.maximum(factor @ gram, _LEAST_ENTRY)
        for power in (0.5, 0.25):
            trial = np.maximum(factor * ratio**power, _LEAST_ENTRY)
            product, gram, loss = measure(trial)
            if loss <= losses[-1]:
                break
        else:  # converged: only rounding errors remain
            break
        factor = trial
        losses.append(loss)
        if losses[-2] - loss <= _TOLERANCE * losses[-2]:
            break
    return factor, losses


_BUILT_IN: dict[str, Callable[..., Clusterer]] = {"kmeans": KMeans, "spectral": Spectral, "snmf": SymmetricNMF}

#: All clusterers by name.
CLUSTERERS = Registry("clusterer", "clusterer", "usnet.clusterers", __name__, check_factory, _BUILT_IN, classes=True)
register_clusterer = CLUSTERERS.register


def make_clusterer(name: str, /, **arguments: Any) -> Clusterer:
    """Create the clusterer of this name: ``make_clusterer("spectral", count="eigengap")``."""
    factory = CLUSTERERS.find(name)
    check_call(f"clusterer {name!r}", factory, arguments)
    return factory(**arguments)
