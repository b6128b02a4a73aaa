"""Baselines: detectors that see no links, and detectors on networks of pairs."""

import numpy as np
import pytest
from scipy.cluster.hierarchy import fcluster, linkage
from synthetic_windows import answer, flight, window_of

from detectors.baselines import (
    CentralMost,
    DirectionalDelays,
    Flica,
    FrontMost,
    LaggedNetwork,
    Mflica,
    NetLagRegression,
    TrackOutlier,
    TransferEntropy,
)
from detectors.baselines.blind import describe_tracks, group_by_distance
from detectors.baselines.transfer_entropy import estimate_transfer_entropy
from detectors.baselines.trivial import RandomDetector
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


@pytest.fixture
def window():
    velocity, _ = flight(np.random.default_rng(0), steps=5)
    alive = np.ones(velocity.shape[1], bool)
    alive[[1, 4]] = False
    return window_of(velocity, alive=alive)


@pytest.mark.parametrize("count", [1, 3, 16, 400])
def test_random_names_as_many_living_uavs_as_asked_for(window, count):
    detector = RandomDetector(count=count)
    detector.reset(3)
    for _ in range(20):
        detection = detector.detect(window)
        assert detection.candidates.sum() == min(count, window.alive.sum())
        assert not (detection.candidates & ~window.alive).any()
        assert detection.scores[detection.candidates].min() >= detection.scores[~detection.candidates].max(initial=0)


def test_random_names_all_uavs_equally_often(window):
    detector = RandomDetector()
    detector.reset(0)
    named = sum(detector.detect(window).candidates.astype(int) for _ in range(3000))
    expected = 3000 / window.alive.sum()
    assert np.abs(named[window.alive] - expected).max() < 5 * np.sqrt(expected)


KINDS = [DirectionalDelays, LaggedNetwork, NetLagRegression, TransferEntropy]
SHAPES = {
    "star": [-1, 0, 0, 0, 0, -1, 5, 5, 5, 5],
    "chain": [-1, 0, 1, 2, 3, -1, 5, 6, 7, 8],
    "tree": [-1, 0, 0, 1, 1, -1, 5, 5, 6, 7],
    "pairs": [-1, 0, -1, 2, -1, 4, -1, 6, -1, 8],
}


def lead_by(leader, delay, steps=200, noise=0.4, seed=0, smooth=0.6):
    """Planar velocities ``(steps, n, 3)``: each copies its leader after its delay; leaders come before followers."""
    rng = np.random.default_rng(seed)
    fresh = rng.standard_normal((steps + 100, len(leader), 3)) * (1, 1, 0)
    for t in range(1, len(fresh)):
        fresh[t] = smooth * fresh[t - 1] + np.sqrt(1 - smooth**2) * fresh[t]
    velocity = fresh.copy()
    for i, (head, late) in enumerate(zip(leader, delay, strict=True)):
        if head >= 0:
            velocity[late:, i] = velocity[: len(fresh) - late, head] + noise * rng.standard_normal(
                (len(fresh) - late, 3)
            ) * (1, 1, 0)
    return velocity[-steps:]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("shape", SHAPES)
def test_heads_are_the_sources_of_stars_chains_and_trees(kind, shape):
    leader = np.array(SHAPES[shape])
    delay = np.array([0, 1, 3, 1, 2, 1, 2, 1, 1, 1])
    right = 0
    for seed in range(3):
        found = answer(kind(), window_of(lead_by(leader, delay, seed=seed)))
        right += np.array_equal(found.candidates, leader < 0)
        if np.array_equal(found.candidates, leader < 0):
            relay = np.isin(np.arange(10), leader) & (leader >= 0)
            assert (found.scores[leader < 0] > 0).all()
            assert (found.scores[leader >= 0] < 0).all()  # a relay is no head, however many it leads
            np.testing.assert_array_equal(found.extras["root"], 5 * (np.arange(10) // 5)) if shape != "pairs" else None
            if kind is not TransferEntropy:
                direct = np.where(leader < 0, np.arange(10), leader)
                assert (found.leader == direct).mean() >= 0.9
                assert (found.extras["relay"] == relay).mean() >= 0.8
    assert right >= (1 if kind is TransferEntropy else 2)


def test_a_delay_per_pair_is_measured_and_told():
    leader, delay = np.array([-1, 0, 0, 0]), np.array([0, 2, 5, 8])
    found = answer(DirectionalDelays(max_lag=10), window_of(lead_by(leader, delay), step=0.5))
    assert found.extras["delay"].tolist() == [-1, 2, 5, 8]
    assert np.flatnonzero(found.candidates).tolist() == [0]
    assert found.extras["reasons"] == ["Leads 3 directly, who follow after 2.5 s; no UAV leads it."]


@pytest.mark.parametrize("kind", [*KINDS, Mflica])
def test_few_windows_without_a_leader_name_any(kind):
    """Independent UAVs, and UAVs that copy a common route at the same time."""
    named = 0
    for seed in range(40):
        velocity = lead_by([-1] * 6, [0] * 6, steps=100, seed=seed)
        if seed % 2:
            velocity = velocity + 2 * lead_by([-1], [0], steps=100, seed=1000 + seed)
        named += answer(kind(), window_of(velocity)).candidates.any()
    assert named <= 7  # 0.05 of 40 are 2; P(more than 7) < 0.001


def test_transfer_entropy_of_gaussian_series_is_the_known_one():
    """For v_i(t) = v_j(t - 1) + noise of variance s² per axis in one axis it is 1/2 ln(1 + 1/s²)."""
    rng = np.random.default_rng(0)
    source = rng.standard_normal((6000, 3)) * (1, 0, 0)
    for variance in (0.5, 2.0):
        velocity = np.stack(
            [source, np.roll(source, 1, axis=0) + np.sqrt(variance) * rng.standard_normal((6000, 3)) * (1, 0, 0)], 1
        )
        estimates = [
            estimate_transfer_entropy(part, np.ones((200, 2), bool), np.ones((2, 2), np.int64), 4)
            for part in np.split(velocity, 30)
        ]
        forward, back = np.mean(estimates, axis=0)[1, 0], np.mean(estimates, axis=0)[0, 1]
        assert forward == pytest.approx(0.5 * np.log1p(1 / variance), rel=0.1)
        assert abs(back) < 0.02


def tandem(uavs=4, apart=6, steps=200, seed=0):
    """UAVs on one path, each where the one before it was ``apart`` steps ago."""
    rng = np.random.default_rng(seed)
    course = np.cumsum(0.2 * rng.standard_normal(steps + apart * uavs + 1))
    path = np.cumsum(np.stack([np.cos(course), np.sin(course), 0 * course], axis=1), axis=0)
    place = np.stack([path[apart * (uavs - 1 - i) :][: steps + 1] for i in range(uavs)], axis=1)
    place = place + 0.05 * rng.standard_normal(place.shape) * (1, 1, 0)
    return Window(place, np.diff(place, axis=0), np.ones(place.shape[:2], bool), np.ones(uavs, bool))


@pytest.mark.parametrize("detector", [FrontMost(), Mflica(), Flica(), FrontMost(max_lag=10)])
def test_the_first_on_a_path_leads(detector):
    found = answer(detector, tandem())
    assert (np.flatnonzero(found.candidates).tolist(), found.leader[0]) == ([0], 0)


@pytest.mark.parametrize("kind", [*KINDS, FrontMost, Mflica, Flica])
def test_short_windows_are_refused(kind):
    with pytest.raises(ArgumentError, match="window must hold more than 4 velocities"):
        answer(kind(), window_of(np.ones((4, 3, 3))))
