"""Clustering of the UAVs of a window, and estimation of the number of clusters."""

from detectors.clustering.base import Clusterer, Clustering, Living
from detectors.clustering.counts import GapStatistic, compute_gap_statistic, estimate_count_by_eigengap
from detectors.clustering.partitions import (
    Agglomerative,
    Hdbscan,
    KMeans,
    LeadVotes,
    Spectral,
    SymmetricNMF,
    factorise_affinity,
)
from detectors.clustering.registry import check_clusterer, clusterers, make_clusterer, register_clusterer

__all__ = [
    "Agglomerative",
    "Clusterer",
    "Clustering",
    "GapStatistic",
    "Hdbscan",
    "KMeans",
    "LeadVotes",
    "Living",
    "Spectral",
    "SymmetricNMF",
    "check_clusterer",
    "clusterers",
    "compute_gap_statistic",
    "estimate_count_by_eigengap",
    "factorise_affinity",
    "make_clusterer",
    "register_clusterer",
]
