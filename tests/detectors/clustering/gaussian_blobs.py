"""Features with a known number of clusters."""

from __future__ import annotations

import numpy as np


def blobs(rng, clusters, dimensions=2, apart=10.0, each=20):
    """Gaussian blobs of unit width whose random centres are at least ``apart``."""
    while True:
        centres = rng.uniform(-1, 1, (clusters, dimensions)) * apart * clusters ** (1 / dimensions)
        if (
            clusters == 1
            or np.linalg.norm(centres[:, None] - centres + 1e9 * np.eye(clusters)[..., None], axis=2).min() > apart
        ):
            break
    return np.repeat(centres, each, axis=0) + rng.standard_normal((clusters * each, dimensions))
