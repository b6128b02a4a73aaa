"""The base class of the clusterers, and their result."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import Annotated, Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from detectors.clustering.affinity import AFFINITIES, Affinity, compute_affinity
from detectors.clustering.counts import compute_gap_statistic, estimate_count_by_eigengap
from detectors.clustering.features import FEATURES, Features, compute_features
from detectors.parameters import Count, Lags, Parameters
from detectors.series.votes import spread
from usnet_env.arrays import Floats, Indices
from usnet_env.config import ArgumentError, quote, unknown_name
from usnet_env.window import Window, frozen_array

COUNTS = ("gap", "gap-one-se", "eigengap")  # the values of count= that estimate the number of clusters beforehand
OWN = "own"  # the value of count= with which a clusterer finds the number of clusters itself


@dataclass(frozen=True, eq=False)
class Clustering:
    """The clusters of one window and what they were computed from. All arrays are read-only copies.

    Args:
        labels: ``(N,)`` int64, 0 to ``count`` - 1 for living UAVs, -1 for destroyed ones.
        count: the number of clusters; 0 if no UAV is alive.
        features: ``(N, d)`` or ``(N, T, d)``, the features (0 for destroyed UAVs), or ``None``.
        affinity: ``(N, N)``, the similarity of every two UAVs from 0 to 1 (0 for destroyed UAVs), or ``None`` if it
            was not computed.
        extras: other values by name; ``"estimate"`` is the number of clusters that was given or estimated before
            clustering.

    Raises:
        ArgumentError: an array has another shape, or the labels of living UAVs are not 0 to ``count`` - 1, each used.
    """

    labels: Indices
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
                f"labels must use every number from 0 to count - 1 = {self.count - 1} and otherwise be -1, "
                f"got {quote(used)}."
            )
        if self.features is not None:
            values = np.asarray(self.features)
            shape = (uavs, None, None) if values.ndim == 3 else (uavs, None)
            put(self, "features", frozen_array("features", values, np.float64, shape))
        if self.affinity is not None:
            put(self, "affinity", frozen_array("affinity", self.affinity, np.float64, (uavs, uavs)))
        put(self, "extras", dict(self.extras))


@dataclass(frozen=True, eq=False)
class Living:
    """Features and affinity of the n living UAVs of a window, computed at first use.

    Args:
        window: the whole window, with all N UAVs.
        arguments: the checked arguments of the clusterer.
    """

    window: Window
    arguments: Any

    @cached_property
    def index(self) -> NDArray[np.intp]:
        """``(n,)`` indices of the living UAVs among the N UAVs of the window."""
        return np.flatnonzero(self.window.alive)

    @cached_property
    def features(self) -> Floats:
        """``(n, d)``, or a time series ``(n, T, d)``."""
        return compute_features(self.arguments.features, self.window, self.arguments.memory)[self.index]

    @cached_property
    def flat(self) -> Floats:
        """``(n, d)``, or ``(n, T d)``: a time series is flattened to one row per UAV."""
        return self.features.reshape(len(self.index), -1)

    @cached_property
    def affinity(self) -> Floats:
        """``(n, n)`` symmetric, from 0 to 1, 1 on the diagonal."""
        return compute_affinity(self.arguments.affinity, self.features, self.arguments.max_lag)


class Clusterer(Parameters):
    """Base class: clusters the living UAVs of one window. A subclass implements :meth:`partition`.

    The constructor only stores its keyword arguments. A window without living UAVs has no cluster; with one living UAV
    it has one. A living UAV that was never seen has the mean features of the others. A ``count`` above the number of
    living UAVs is lowered to it. K-Means and SNMF may return fewer clusters than ``count``.

    Args:
        count: the number of clusters, or how to estimate it: ``"gap"``
            (:func:`detectors.clustering.compute_gap_statistic` of the features), ``"gap-one-se"`` (the same with
            ``margin=math.inf``, the one-standard-error rule of Tibshirani et al.) or ``"eigengap"``
            (:func:`detectors.clustering.estimate_count_by_eigengap` of the affinity).
        features: ``"raw"``, ``"scaled"`` or ``"velocities"`` (see :mod:`detectors.clustering.features`), or a callable
            from a window to ``(N, d)`` or a time series ``(N, T, d)``.
        affinity: ``"lag"`` (time series only), ``"rbf"`` or ``"cosine"`` (see :mod:`detectors.clustering.affinity`), or
            a callable from the features of n UAVs to ``(n, n)``; ``None``: ``"lag"`` for a time series, else ``"rbf"``.
        max_lag: L, the longest lag of ``"lag"``, in samples, at least 0.
        memory: T_0, the number of samples in ``"raw"`` and ``"scaled"``.

    Raises:
        ArgumentError: raised by :meth:`cluster` for an invalid argument.
    """

    counts: ClassVar[tuple[str, ...]] = COUNTS  #: the strings that ``count`` accepts

    count: Count | str = "eigengap"
    features: str | Features = "velocities"
    affinity: str | Affinity | None = None
    max_lag: Annotated[int, Field(ge=0, le=1000)] = 4
    memory: Lags = 4

    def check_arguments(self) -> Any:
        """Check all arguments and return them."""
        common = super().check_arguments()
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
            window: the observer's window.
            rng: generator of all random numbers.

        Raises:
            ArgumentError: an argument is invalid, or the callable given as ``features`` or ``affinity`` returned an
                invalid array.
        """
        arguments = self.check_arguments()
        living = Living(window, arguments)
        n = len(living.index)
        labels = np.full(window.uavs, -1, np.int64)
        if n < 2:
            labels[living.index] = 0
            return Clustering(labels, n, extras={"estimate": 1} if n else {})
        estimate = self._estimate_count(living, rng)
        found = self.partition(living, None if estimate is None else min(estimate, n), rng)
        used, labels[living.index] = np.unique(found, return_inverse=True)
        widen = partial(spread, members=living.index, uavs=window.uavs)
        affinity = widen(living.affinity, pairs=True) if "affinity" in vars(living) else None  # if it was computed
        extras = {"estimate": len(used) if estimate is None else estimate}
        return Clustering(labels, len(used), widen(living.features), affinity, extras)

    def _estimate_count(self, living: Living, rng: np.random.Generator) -> int | None:
        count = living.arguments.count
        if isinstance(count, int):
            return count
        if count == "gap":
            return compute_gap_statistic(living.flat, rng).count
        if count == "gap-one-se":
            return compute_gap_statistic(living.flat, rng, margin=np.inf).count
        return estimate_count_by_eigengap(living.affinity, rng) if count == "eigengap" else None

    @abstractmethod
    def partition(self, living: Living, count: int | None, rng: np.random.Generator) -> NDArray[np.integer[Any]]:
        """Assign a label to each of the n ≥ 2 living UAVs, ``(n,)``; any whole numbers are valid labels.

        Args:
            living: features and affinity of the living UAVs.
            count: the number of clusters, 1 to n; ``None`` if the clusterer finds it itself (``count="own"``).
            rng: generator of all random numbers.
        """
