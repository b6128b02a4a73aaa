"""The clusterers that come with the project, by name."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from sklearn.cluster import HDBSCAN, AgglomerativeClustering, spectral_clustering
from sklearn.cluster import KMeans as SklearnKMeans

from detectors.clustering.affinity import Affinity
from detectors.clustering.base import OWN, Clusterer, ClustererArguments, Living, register_clusterer
from detectors.clustering.count import COUNTS, normalised, regularised
from detectors.clustering.features import Features
from detectors.clustering.snmf import symmetric_nmf
from detectors.lagged.regression import regression_evidence
from detectors.lagged.selection import detection_from_evidence
from usnet_env.config import ArgumentError, Config, quote, unknown_name

__all__ = ["Agglomerative", "Hdbscan", "KMeans", "LeadVotes", "Spectral", "SymmetricNMF"]

Labels = NDArray[np.int64]

STARTS = 10  # of K-Means


def _seed(rng: np.random.Generator) -> int:
    """A seed for scikit-learn."""
    return int(rng.integers(2**31))


class KMeans(Clusterer):
    """K-Means on the features, a series laid out in a row."""

    def partition(self, living: Living, count: int | None, rng: np.random.Generator) -> Labels:
        """Labels ``(n,)`` by scikit-learn, best of 10 starts."""
        assert count is not None
        most = min(count, len(np.unique(living.flat, axis=0)))
        found: Labels = SklearnKMeans(most, n_init=STARTS, random_state=_seed(rng)).fit_predict(living.flat)
        return found


class Spectral(Clusterer):
    """Spectral clustering of the regularised affinity (see :func:`detectors.clustering.count.regularised`)."""

    def partition(self, living: Living, count: int | None, rng: np.random.Generator) -> Labels:
        """Labels ``(n,)`` by scikit-learn."""
        assert count is not None
        if count == 1 or count >= len(living.index):
            return np.zeros(len(living.index), np.int64) if count == 1 else np.arange(count)
        # K-Means on the embedding now and then spends a cluster on a head that resembles nobody; cluster_qr does not.
        found: Labels = spectral_clustering(
            regularised(living.affinity), n_clusters=count, random_state=_seed(rng), assign_labels="cluster_qr"
        )
        return found


class _SymmetricNMFArguments(Config):
    starts: Annotated[int, Field(ge=1)]
    steps: Annotated[int, Field(ge=1)]


class SymmetricNMF(Clusterer):
    """Symmetric non-negative matrix factorisation of the normalised affinity, A ≈ H Hᵀ; the label is a row's peak.

    Args:
        count, features, affinity, max_lag, memory: as in :class:`detectors.clustering.Clusterer`.
        starts: random starts; the lowest loss counts.
        steps: the most updates of each.
    """

    def __init__(
        self,
        count: int | str = "eigengap",
        features: str | Features = "velocities",
        affinity: str | Affinity | None = None,
        max_lag: int = 4,
        memory: int = 4,
        starts: int = 5,
        steps: int = 300,
    ) -> None:
        super().__init__(count, features, affinity, max_lag, memory)
        self.starts = starts
        self.steps = steps

    def check_arguments(self) -> ClustererArguments:
        """The common arguments, or ``ArgumentError``."""
        _SymmetricNMFArguments(starts=self.starts, steps=self.steps)
        return super().check_arguments()

    def partition(self, living: Living, count: int | None, rng: np.random.Generator) -> Labels:
        """Labels ``(n,)`` of the best start."""
        assert count is not None
        matrix = normalised(living.affinity)
        fits = [symmetric_nmf(matrix, count, rng, self.steps) for _ in range(self.starts)]
        best = min(fits, key=lambda fit: float(fit[1][-1]))
        return best[0].argmax(axis=1).astype(np.int64)


LINKAGES = ("average", "complete", "single")


class Agglomerative(Clusterer):
    """Agglomerative clustering of the distances 1 - affinity.

    Args:
        count, features, affinity, max_lag, memory: as in :class:`detectors.clustering.Clusterer`.
        linkage: ``"average"``, ``"complete"`` or ``"single"``.
    """

    def __init__(
        self,
        count: int | str = "eigengap",
        features: str | Features = "velocities",
        affinity: str | Affinity | None = None,
        max_lag: int = 4,
        memory: int = 4,
        linkage: str = "complete",
    ) -> None:
        super().__init__(count, features, affinity, max_lag, memory)
        self.linkage = linkage

    def check_arguments(self) -> ClustererArguments:
        """The common arguments, or ``ArgumentError``."""
        if self.linkage not in LINKAGES:
            raise unknown_name("linkage", self.linkage, LINKAGES)
        return super().check_arguments()

    def partition(self, living: Living, count: int | None, rng: np.random.Generator) -> Labels:
        """Labels ``(n,)`` by scikit-learn; nothing is random."""
        model = AgglomerativeClustering(count, metric="precomputed", linkage=self.linkage)
        found: Labels = model.fit_predict(1.0 - living.affinity)
        return found


class _HdbscanArguments(Config):
    least: Annotated[int, Field(ge=2)]


class Hdbscan(Clusterer):
    """HDBSCAN on the distances 1 - affinity; it finds the number of clusters itself.

    What HDBSCAN calls noise joins the cluster of the clustered UAV that it has the highest affinity to. Where all is
    noise there is one cluster.

    Args:
        count: ``"own"`` and nothing else.
        features, affinity, max_lag, memory: as in :class:`detectors.clustering.Clusterer`.
        least: members that make a cluster, at least 2.
    """

    counts = (OWN,)

    def __init__(
        self,
        count: int | str = OWN,
        features: str | Features = "velocities",
        affinity: str | Affinity | None = None,
        max_lag: int = 4,
        memory: int = 4,
        least: int = 3,
    ) -> None:
        super().__init__(count, features, affinity, max_lag, memory)
        self.least = least

    def check_arguments(self) -> ClustererArguments:
        """The common arguments, or ``ArgumentError``."""
        _HdbscanArguments(least=self.least)
        if self.count != OWN:
            raise ArgumentError(f"count must be {OWN!r} for HDBSCAN, which counts by itself, got {quote(self.count)}.")
        return super().check_arguments()

    def partition(self, living: Living, count: int | None, rng: np.random.Generator) -> Labels:
        """Labels ``(n,)`` by scikit-learn; nothing is random."""
        n = len(living.index)
        if n < self.least:
            return np.zeros(n, np.int64)
        model = HDBSCAN(min_cluster_size=self.least, min_samples=1, metric="precomputed", copy=True)
        found: Labels = model.fit_predict(1.0 - living.affinity).astype(np.int64)
        clustered = found >= 0
        if not clustered.any():
            return np.zeros(n, np.int64)
        found[~clustered] = found[clustered][living.affinity[~clustered][:, clustered].argmax(axis=1)]
        return found


class _LeadVotesArguments(Config):
    lags: Annotated[int, Field(ge=1)]
    squares: bool
    ridge: Annotated[float, Field(ge=0)]


class LeadVotes(Clusterer):
    """Every UAV joins the one, of the most voted for, whose past best explains its velocities.

    The evidence is the adjusted R² of pairwise lagged regression, and M̂ ``"own"`` the number of leaders that cover the
    significant voters: clusters of :class:`detectors.lagged.LaggedRegression` behind this contract. It always looks at
    the window's velocities; ``features`` and ``affinity`` serve to estimate the number only.

    Args:
        count: a whole number, ``"gap"``, ``"eigengap"`` or ``"own"``.
        features, affinity, max_lag, memory: as in :class:`detectors.clustering.Clusterer`.
        lags, squares, ridge: as in :class:`detectors.lagged.LaggedRegression`.
    """

    counts = (*COUNTS, OWN)

    def __init__(
        self,
        count: int | str = OWN,
        features: str | Features = "velocities",
        affinity: str | Affinity | None = None,
        max_lag: int = 4,
        memory: int = 4,
        lags: int = 4,
        squares: bool = True,
        ridge: float = 1e-3,
    ) -> None:
        super().__init__(count, features, affinity, max_lag, memory)
        self.lags = lags
        self.squares = squares
        self.ridge = ridge

    def check_arguments(self) -> ClustererArguments:
        """The common arguments, or ``ArgumentError``."""
        _LeadVotesArguments(lags=self.lags, squares=self.squares, ridge=self.ridge)
        return super().check_arguments()

    def partition(self, living: Living, count: int | None, rng: np.random.Generator) -> Labels:
        """Labels ``(n,)``; ``rng`` breaks ties between leaders."""
        window, index = living.window, living.index
        evidence = regression_evidence(
            window.velocity[:, index], window.velocity_seen[:, index], self.lags, self.squares, self.ridge
        )
        everybody = np.ones(len(index), bool)
        clusters = detection_from_evidence(evidence, everybody, count, first_round=True, rng=rng).clusters
        assert clusters is not None
        return clusters


for _name, _kind in {
    "kmeans": KMeans,
    "spectral": Spectral,
    "snmf": SymmetricNMF,
    "agglomerative": Agglomerative,
    "hdbscan": Hdbscan,
    "lead-votes": LeadVotes,
}.items():
    register_clusterer(_name, _kind)
