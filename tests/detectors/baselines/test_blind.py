"""Detectors that can't see who follows whom."""

import numpy as np
import pytest
from scipy.cluster.hierarchy import fcluster, linkage
from synthetic_windows import window_of

from detectors.baselines import CentralMost, TrackOutlier
from detectors.baselines.blind import describe_tracks, group_by_distance
from usnet_env import ArgumentError, Window


def test_groups_are_single_linkage_clusters():
    rng = np.random.default_rng(0)
    for _ in range(20):
        place = rng.uniform(0, 100, (25, 3))
        gaps = np.linalg.norm(place[:, None] - place, axis=2) + np.diag(np.full(25, np.inf))
        group = fcluster(linkage(place), 1.3 * np.median(gaps.min(axis=1)), "distance") - 1
        found = group_by_distance(place, 1.3)
        assert ((found >= 0) == (np.bincount(group, minlength=25)[group] >= 3)).all()
        for one in range(found.max() + 1):
            assert len(set(group[found == one])) == 1
            assert (group == group[found == one][0]).sum() == (found == one).sum()


def test_central_most_names_the_middle_of_each_group():
    rng = np.random.default_rng(1)
    place = np.concatenate([rng.normal(0, 5, (8, 3)), rng.normal(0, 5, (6, 3)) + 500, [[900.0, 0.0, 0.0]]])
    place[3], place[10] = place[[0, 1, 2, 4, 5, 6, 7]].mean(axis=0), place[[8, 9, 11, 12, 13]].mean(axis=0)
    velocity = rng.normal(size=(9, 15, 3)).astype(np.float32)
    position = np.concatenate([place[None], place + np.cumsum(velocity, axis=0)])
    detection = CentralMost().detect(Window(position, velocity, np.ones((10, 15), bool), np.ones(15, bool)))
    assert np.flatnonzero(detection.candidates).tolist() == [3, 10]
    assert detection.scores[14] == 0


def test_track_outlier_names_the_track_unlike_the_others():
    rng = np.random.default_rng(2)
    velocity = rng.normal([1.0, 0.0, 0.0], 0.2, (60, 12, 3))
    velocity[:, 7] = rng.normal([0.8, 0.6, 0.0], 0.01, (60, 3))
    detection = TrackOutlier().detect(window_of(velocity))
    assert detection.candidates[7]
    assert detection.scores.argmax() == 7
    assert TrackOutlier(threshold=1000).detect(window_of(velocity)).candidates.sum() == 1
    with pytest.raises(ArgumentError, match=r"^window must hold more than 1 "):
        TrackOutlier().detect(window_of(velocity[:1]))
    turned = velocity @ np.linalg.qr(rng.normal(size=(3, 3)))[0]
    np.testing.assert_allclose(describe_tracks(turned), describe_tracks(velocity), atol=1e-9)
