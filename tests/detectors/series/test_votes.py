"""The votes of equations (12), (19) and (20), the top K of (21) and (22), ties, and the cover of the voters."""

import numpy as np
import pytest

from detectors.series.votes import Evidence, choose_heads, count_votes, cover_voters, detection_from_evidence


@pytest.mark.parametrize("seed", range(5))
def test_votes_are_equation_20(seed):
    chosen = np.random.default_rng(seed).integers(0, 7, 7)
    c = count_votes(chosen)
    for i in range(7):
        assert c[i] == pytest.approx(sum(chosen[other] == i for other in range(7) if other != i) / 7)


@pytest.mark.parametrize("exclude_self", [False, True])
def test_ties_of_attention_favour_no_index(exclude_self):
    rng = np.random.default_rng(0)
    even = np.full((5, 5), 0.2)
    counts = np.zeros((5, 5))
    for _ in range(1000):
        counts[np.arange(5), choose_heads(even, exclude_self, rng)] += 1
    if exclude_self:
        assert (np.diag(counts) == 0).all()
        counts = counts[~np.eye(5, dtype=bool)]
    expected = 1000 / (4 if exclude_self else 5)
    assert (np.abs(counts - expected) < 5 * np.sqrt(expected)).all()


def test_a_head_needs_voters_that_no_other_head_explains():
    pairs = np.zeros((9, 9))
    pairs[[1, 2, 3], 0] = 0.9  # three follow 0
    pairs[3, 2] = 0.95  # one of them looks a little more like its fellow
    pairs[[5, 6], 4] = 0.8, 0.7  # two follow 4
    pairs[8, 7] = 0.9  # a single stray voter
    np.fill_diagonal(pairs, -np.inf)
    surrogate = np.zeros((9, 9))
    evidence = Evidence(pairs, surrogate, spread=0.05)
    assert evidence.threshold == pytest.approx(0.15)
    assert cover_voters(evidence) == [0, 4]
    assert cover_voters(evidence, most=1) == [0]
    assert cover_voters(Evidence(surrogate, surrogate, spread=0.05)) == []
    found = detection_from_evidence(evidence, np.ones(9, bool), None, False, np.random.default_rng(0))
    np.testing.assert_allclose(found.scores, [1.8, 0, 0.95, 0, 1.5, 0, 0, 0.9, 0])  # the weighted votes
