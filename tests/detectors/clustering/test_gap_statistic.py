"""The gap statistic against a literal reading of its paper, and its use by the clusterers."""

import literal_gap
import numpy as np
import pytest
from gaussian_blobs import blobs
from sklearn.cluster import KMeans as SklearnKMeans

from detectors.clustering import compute_gap_statistic, make_clusterer
from detectors.clustering.counts import compute_dispersions
from usnet_env import Window

REFERENCES = 4  # few, so that sqrt(1 + 1/B) = 1.118 is far from 1


def window_of(uavs):
    """A window whose content does not matter: the features are given by a callable."""
    return Window(np.zeros((3, uavs, 3)), np.zeros((2, uavs, 3)), np.ones((3, uavs), bool), np.ones(uavs, bool))


def estimate(rows, rule, seed):
    clusterer = make_clusterer("kmeans", count=rule, features=lambda window: rows)
    return clusterer.cluster(window_of(len(rows)), np.random.default_rng(seed)).extras["estimate"]


def stick(uavs=60):
    """A thin stick along the diagonal of the plane, with evenly spaced rows: one cluster."""
    along, across = np.linspace(-10, 10, uavs), np.random.default_rng(0).uniform(-0.3, 0.3, uavs)
    return np.stack([along - across, along + across], axis=1) / np.sqrt(2)


@pytest.mark.parametrize("seed", range(5))
def test_gap_and_deviation_are_those_of_the_paper(seed):
    """On a line the axis needs no rotation, and the best clusters are intervals: the lowest W_k is known exactly."""
    rng = np.random.default_rng(seed)
    rows = np.concatenate([rng.normal(0, 1, 5), rng.normal(9, 1, 4)])[:, None]
    found = compute_gap_statistic(rows, np.random.default_rng(seed), max_count=3, references=REFERENCES, margin=np.inf)
    again = np.random.default_rng(seed)  # the references are the first numbers that are drawn
    centred = rows - rows.mean()
    uniform = centred.min() + (centred.max() - centred.min()) * again.random((REFERENCES, *rows.shape))
    sets = np.concatenate([centred[None], uniform])
    assert len(found.gap) >= 2
    gaps, deviations = [], []
    for k, within in zip(range(1, len(found.gap) + 1), compute_dispersions(sets, again), strict=False):
        lowest = np.array([literal_gap.lowest_within_sum(values, k) for values in sets])
        assert (within >= lowest * (1 - 1e-5)).all()
        assert (within <= lowest * (1.3 if k > 1 else 1 + 1e-9)).all()  # K-Means may stop at a local minimum
        gap, deviation = literal_gap.gap_and_deviation(np.log(within[0]), np.log(within[1:]))
        gaps.append(gap)
        deviations.append(deviation)
    np.testing.assert_allclose(found.gap, gaps, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(found.deviation, deviations, rtol=1e-9)
    assert found.count == (literal_gap.one_standard_error_count(gaps, deviations) or 3)


def test_references_lie_along_the_principal_axes():
    """For a rotated stick the box of the features and the box along the principal axes give different log W_k."""
    rows, draws = stick(), 60
    found = compute_gap_statistic(rows, np.random.default_rng(1), max_count=3, references=draws, margin=np.inf)
    # margin=inf may stop at k = 1 and then knows Gap(1) and Gap(2)
    k = 2

    def log_within(values):
        return np.log(SklearnKMeans(k, n_init=3, random_state=0).fit(values).inertia_)

    expected = {}
    for name in ("references_along_principal_axes", "references_in_the_range"):
        sets = getattr(literal_gap, name)(rows, draws, np.random.default_rng(2))
        expected[name] = literal_gap.gap_and_deviation(log_within(rows), [log_within(values) for values in sets])
    along, deviation = expected["references_along_principal_axes"]
    assert found.gap[k - 1] == pytest.approx(along, abs=4 * deviation * np.sqrt(2 / draws))
    in_the_range, other_deviation = expected["references_in_the_range"]
    assert in_the_range > along + 5 * max(deviation, other_deviation)  # the two readings can be distinguished


@pytest.mark.parametrize("rule", ["gap", "gap-one-se"])
def test_a_rotated_stick_is_one_cluster(rule):
    """With references in the box of the features, a stick looks like two clusters or more."""
    assert [estimate(stick(), rule, seed) for seed in range(3)] == [1] * 3


def test_the_one_standard_error_rule_is_not_the_maximum_of_the_gap():
    """A later gap is higher, but by less than its s: the rule takes the smaller k."""
    differ = 0
    for seed in range(12):
        rows = np.random.default_rng(seed).random((40, 2))
        found = compute_gap_statistic(rows, np.random.default_rng(seed), margin=np.inf)
        assert found.count == literal_gap.one_standard_error_count(found.gap, found.deviation)
        differ += found.count != int(np.argmax(found.gap)) + 1
    assert differ >= 1


def test_gap_one_se_stops_where_the_paper_stops_and_gap_does_not():
    """Ten blobs in the plane: the first splits reduce W_k no more than those of a uniform cloud."""
    alone = []
    for seed in range(2):
        rows = blobs(np.random.default_rng(seed), 10)
        found = compute_gap_statistic(rows, np.random.default_rng(seed), margin=np.inf)
        alone.append(estimate(rows, "gap-one-se", seed))
        assert alone[-1] == found.count == literal_gap.one_standard_error_count(found.gap, found.deviation)
        assert estimate(rows, "gap", seed) == 10
    assert min(alone) < 10
