"""Clustering of the UAVs of a window, and estimation of the number of clusters."""

from detectors.clustering.clusterers import (
    CLUSTERERS,
    Clusterer,
    Clustering,
    KMeans,
    make_clusterer,
    register_clusterer,
)

__all__ = ["CLUSTERERS", "Clusterer", "Clustering", "KMeans", "make_clusterer", "register_clusterer"]
