"""Which UAVs fly together? Clusterers of a window behind one contract, and the number of clusters."""

from detectors.clustering.base import (
    Clusterer,
    Clustering,
    Living,
    clusterers,
    make_clusterer,
    register_clusterer,
)
from detectors.clustering.count import Gap, eigengap, gap
from detectors.clustering.partitions import Agglomerative, Hdbscan, KMeans, LeadVotes, Spectral, SymmetricNMF
from detectors.clustering.snmf import symmetric_nmf

__all__ = [
    "Agglomerative",
    "Clusterer",
    "Clustering",
    "Gap",
    "Hdbscan",
    "KMeans",
    "LeadVotes",
    "Living",
    "Spectral",
    "SymmetricNMF",
    "clusterers",
    "eigengap",
    "gap",
    "make_clusterer",
    "register_clusterer",
    "symmetric_nmf",
]
