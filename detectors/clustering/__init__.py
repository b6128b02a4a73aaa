"""Clustering of the UAVs of a window, and estimation of the number of clusters."""

from detectors.clustering.clusterers import (
    CLUSTERERS,
    Agglomerative,
    Clusterer,
    Clustering,
    Hdbscan,
    KMeans,
    LeadVotes,
    Living,
    Spectral,
    SymmetricNMF,
    check_clusterer,
    make_clusterer,
    register_clusterer,
)
from detectors.clustering.counts import GapStatistic, compute_gap_statistic, estimate_count_by_eigengap
from detectors.clustering.factorisation import factorise_affinity

__all__ = [
    "CLUSTERERS",
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
    "compute_gap_statistic",
    "estimate_count_by_eigengap",
    "factorise_affinity",
    "make_clusterer",
    "register_clusterer",
]
