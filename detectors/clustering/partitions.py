"""The built-in clusterers."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field
from sklearn.cluster import HDBSCAN, AgglomerativeClustering, spectral_clustering
from sklearn.cluster import KMeans as SklearnKMeans

from detectors.clustering.affinity import normalise_affinity, regularise_affinity
from detectors.clustering.base import COUNTS, OWN, Clusterer, Living
from detectors.parameters import Count, Lags
from detectors.series.evidence import regression_evidence
from detectors.series.votes import detection_from_evidence
from usnet_env.arrays import Floats, Indices
from usnet_env.config import ArgumentError, quote

STARTS = 10  # of K-Means; the start with the lowest within-cluster dispersion is used
_LEAST = 1e-12  # lower bound of an entry: the multiplicative update would keep an entry of 0 forever


class KMeans(Clusterer):
    """K-Means on the features; a time series is flattened to one row per UAV."""

    def partition(self, living: Living, count: int | None, rng: np.random.Generator) -> Indices:
        """Return labels ``(n,)`` by scikit-learn: the best of ten starts; no more clusters than distinct rows."""
        assert count is not None
        count = min(count, len(np.unique(living.flat, axis=0)))
        model = SklearnKMeans(count, n_init=STARTS, random_state=int(rng.integers(2**31)))
        return model.fit_predict(living.flat)


class Spectral(Clusterer):
    """Spectral clustering of the regularised affinity."""

    def partition(self, living: Living, count: int | None, rng: np.random.Generator) -> Indices:
        """Return labels ``(n,)`` by scikit-learn."""
        assert count is not None
        if count in (1, len(living.index)):
            return np.arange(len(living.index)) % count
        # K-Means on the embedding sometimes makes a cluster of one head that is similar to no UAV; cluster_qr does not.
        affinity, state = regularise_affinity(living.affinity), int(rng.integers(2**31))
        return spectral_clustering(affinity, n_clusters=count, random_state=state, assign_labels="cluster_qr")


class SymmetricNMF(Clusterer):
    """Symmetric non-negative matrix factorisation of the normalised affinity, A ≈ H Hᵀ.

    The label of a UAV is the column of the largest entry in its row of H.

    Args:
        count, features, affinity, max_lag, memory: as in :class:`detectors.clustering.Clusterer`.
        starts: the number of random starts; the one with the lowest loss is used.
        steps: the largest number of updates of each start.
    """

    starts: Annotated[int, Field(ge=1, le=1_000_000)] = 5
    steps: Annotated[int, Field(ge=1, le=1_000_000)] = 300

    def partition(self, living: Living, count: int | None, rng: np.random.Generator) -> Indices:
        """Return labels ``(n,)`` of the best start."""
        assert count is not None
        matrix = normalise_affinity(living.affinity)
        fits = [factorise_affinity(matrix, count, rng, self.steps) for _ in range(living.arguments.starts)]
        best = min(fits, key=lambda fit: float(fit[1][-1]))
        return best[0].argmax(axis=1).astype(np.int64)


def factorise_affinity(
    affinity: Floats, rank: int, rng: np.random.Generator, steps: int = 300, tolerance: float = 1e-5
) -> tuple[Floats, Floats]:
    """Find a local minimum of |A - H Hᵀ|² over H ≥ 0 from a random start (Kuang, Ding and Park, SIAM SDM 2012).

    The update is H ← H ∘ (A H / H Hᵀ H)^p. With p = 1/4 it minimises an upper bound of the loss that is equal to the
    loss at H, so the loss never rises. With p = 1/2 it is faster near a minimum, but the loss may rise; such an update
    is used only if the loss does not rise.

    Args:
        affinity: A, ``(n, n)`` symmetric, ≥ 0.
        rank: the number of columns of H.
        rng: generator of the start: uniform, scaled so that H Hᵀ has the mean size of A.
        steps: the largest number of updates.
        tolerance: stop when an update reduces the loss by at most this share.

    Returns:
        H ``(n, rank)``, and the loss at the start and after every update ``(updates + 1,)``.
    """
    size = float((affinity**2).sum())
    factor = 2.0 * np.sqrt(affinity.mean() / rank) * rng.random((len(affinity), rank)) + _LEAST
    product, gram = affinity @ factor, factor.T @ factor
    losses = [_compute_loss(size, factor, product, gram)]
    for _ in range(steps):
        ratio = product / np.maximum(factor @ gram, _LEAST)
        for power in (0.5, 0.25):
            trial = np.maximum(factor * ratio**power, _LEAST)
            product, gram = affinity @ trial, trial.T @ trial
            loss = _compute_loss(size, trial, product, gram)
            if loss <= losses[-1]:
                break
        else:  # converged: only rounding errors remain
            break
        factor = trial
        losses.append(loss)
        if losses[-2] - loss <= tolerance * losses[-2]:
            break
    return factor, np.array(losses)


def _compute_loss(size: float, factor: Floats, product: Floats, gram: Floats) -> float:
    """Compute |A - H Hᵀ|² from |A|², A H and Hᵀ H; rounding errors below 0 are cut off."""
    return max(size - 2.0 * float((factor * product).sum()) + float((gram**2).sum()), 0.0)


class Agglomerative(Clusterer):
    """Agglomerative clustering of the distances 1 - affinity.

    Args:
        count, features, affinity, max_lag, memory: as in :class:`detectors.clustering.Clusterer`.
        linkage: ``"average"``, ``"complete"`` or ``"single"``.
    """

    linkage: Literal["average", "complete", "single"] = "complete"

    def partition(self, living: Living, count: int | None, rng: np.random.Generator) -> Indices:
        """Return labels ``(n,)`` by scikit-learn; ``rng`` is not used."""
        model = AgglomerativeClustering(count, metric="precomputed", linkage=self.linkage)
        return model.fit_predict(1.0 - living.affinity)


class Hdbscan(Clusterer):
    """HDBSCAN on the distances 1 - affinity, which also estimates the number of clusters.

    A UAV that HDBSCAN labels as noise joins the cluster of the UAV that it is most similar to among those with a
    cluster. If all UAVs are noise, they are one cluster.

    Args:
        count: ``"own"``, the only value.
        features, affinity, max_lag, memory: as in :class:`detectors.clustering.Clusterer`.
        least: the smallest number of members of a cluster, at least 2.
    """

    counts: ClassVar[tuple[str, ...]] = (OWN,)

    count: Count | str = OWN
    least: Annotated[int, Field(ge=2, le=100_000)] = 3

    def check_arguments(self) -> Any:
        """Check all arguments and return them."""
        if not isinstance(self.count, str) or self.count != OWN:
            raise ArgumentError(
                f"count must be {OWN!r} for HDBSCAN, which estimates the number of clusters, got {quote(self.count)}."
            )
        return super().check_arguments()

    def partition(self, living: Living, count: int | None, rng: np.random.Generator) -> Indices:
        """Return labels ``(n,)`` by scikit-learn; ``rng`` is not used."""
        n, least = len(living.index), living.arguments.least
        if n < least:
            return np.zeros(n, np.int64)
        model = HDBSCAN(min_cluster_size=least, min_samples=1, metric="precomputed", copy=True)
        found: Indices = model.fit_predict(1.0 - living.affinity).astype(np.int64)
        clustered = found >= 0
        if not clustered.any():
            return np.zeros(n, np.int64)
        found[~clustered] = found[clustered][living.affinity[~clustered][:, clustered].argmax(axis=1)]
        return found


class LeadVotes(Clusterer):
    """Clusters of the UAVs that vote for the same leader, with the votes of ``lagged-regression``.

    Each UAV votes for the UAV whose past velocities explain its velocities best, by the adjusted R² of pairwise lagged
    regression. The UAVs with the most votes are the leaders, and each UAV joins the leader with the highest R².
    ``count="own"`` takes as many leaders as are needed to cover the significant votes. The votes always use the
    velocities of the window; ``features`` and ``affinity`` only serve ``"gap"`` and ``"eigengap"``.

    Args:
        count: a whole number, ``"gap"``, ``"gap-one-se"``, ``"eigengap"`` or ``"own"``.
        features, affinity, max_lag, memory: as in :class:`detectors.clustering.Clusterer`.
        lags, squares, ridge: as in :class:`detectors.lagged.LaggedRegression`.
    """

    counts: ClassVar[tuple[str, ...]] = (*COUNTS, OWN)

    count: Count | str = OWN
    lags: Lags = 4
    squares: bool = True
    ridge: Annotated[float, Field(ge=0)] = 1e-3

    def partition(self, living: Living, count: int | None, rng: np.random.Generator) -> Indices:
        """Return labels ``(n,)``; ``rng`` breaks ties between leaders."""
        window, index, given = living.window, living.index, living.arguments
        evidence = regression_evidence(
            window.velocity[:, index], window.velocity_seen[:, index], given.lags, given.squares, given.ridge
        )
        candidates = np.ones(len(index), bool)
        clusters = detection_from_evidence(evidence, candidates, count, first_round=True, rng=rng).clusters
        assert clusters is not None
        return clusters
