"""The objectives against a slow, literal reading of the paper's formulas (§II-A and §II-B), with Python sets."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from sklearn.metrics import average_precision_score, f1_score, precision_score, recall_score

from usnet_env import Detection, objectives

UAVS = st.integers(1, 12)


def as_set(mask):
    return {i for i in range(len(mask)) if mask[i]}


@st.composite
def episodes(draw):
    """Heads (N,), at least one, and candidates (R, N)."""
    uavs, rounds = draw(UAVS), draw(st.integers(1, 6))
    head = draw(hnp.arrays(bool, uavs))
    head[draw(st.integers(0, uavs - 1))] = True
    return head, draw(hnp.arrays(bool, (rounds, uavs)))


@st.composite
def clusterings(draw):
    """Heads, leaders and labels of one round."""
    uavs = draw(st.integers(1, 10))
    head = draw(hnp.arrays(bool, uavs))
    chiefs = [int(i) for i in np.flatnonzero(head)]
    leader = [i if head[i] else draw(st.sampled_from([-1, *chiefs])) for i in range(uavs)]
    return head, np.array(leader), draw(hnp.arrays(np.int64, uavs, elements=st.integers(-1, 3)))


@given(episodes())
def test_multi_cluster_objective_is_the_formula(episode):
    head, candidates = episode
    remaining = as_set(head)  # H_0
    redundant_total = hit_total = 0
    for r, named in enumerate(map(as_set, candidates)):
        redundant = named - remaining  # C_r \ H_{r-1}
        hit = remaining - (remaining - named)  # H_{r-1} \ H_r
        redundant_total += len(redundant)
        hit_total += len(hit)
        remaining = remaining - named  # H_r = H_{r-1} \ C_r
        assert as_set(objectives.remaining_heads(head, candidates)[r + 1]) == remaining
    assert objectives.multi_cluster_objective(head, candidates) == len(candidates) + redundant_total / len(head)
    assert objectives.redundancy(head, candidates) == redundant_total / len(head)
    assert objectives.found_all_heads(head, candidates) == (not remaining) == (hit_total == head.sum())


@given(UAVS, st.data())
def test_with_any_number_of_heads_the_single_cluster_objective_is_minus_the_redundant_candidates(uavs, data):
    head, candidates = (data.draw(hnp.arrays(bool, uavs)) for _ in range(2))
    wrong = -len(as_set(candidates) - as_set(head))
    expected = wrong if candidates.any() else -1 if head.any() else 0
    assert objectives.single_cluster_objective(head, candidates) == expected


@given(episodes())
def test_a_batch_is_its_rows(episode):
    head, candidates = episode
    heads, alive = np.broadcast_to(head, candidates.shape), candidates[::-1]
    batch = objectives.hits_and_redundant(heads, alive, candidates)
    rows = [objectives.hits_and_redundant(head, a, c) for a, c in zip(alive, candidates, strict=True)]
    assert np.stack(batch, axis=1).tolist() == [[int(h), int(r)] for h, r in rows]
    for function in (objectives.precision, objectives.recall, objectives.f1, objectives.exact):
        assert function(heads, candidates).tolist() == [function(head, c) for c in candidates]


@settings(max_examples=40)  # scikit-learn's functions are slow
@given(episodes())
def test_ratios_agree_with_scikit_learn(episode):
    head, candidates = episode
    named = candidates[0]
    assert objectives.precision(head, named) == pytest.approx(precision_score(head, named, zero_division=0))
    assert objectives.recall(head, named) == pytest.approx(recall_score(head, named, zero_division=0))
    assert objectives.f1(head, named) == pytest.approx(f1_score(head, named, zero_division=0))
    assert objectives.exact(head, named) == (as_set(head) == as_set(named))


def test_conventions_where_a_ratio_has_no_value():
    none, some = np.zeros(3, bool), np.array([True, False, False])
    assert objectives.precision(some, none) == objectives.recall(some, none) == objectives.f1(some, none) == 0
    assert objectives.recall(none, some) == objectives.f1(none, some) == 0
    assert objectives.f1(none, none) == 1  # as exact
    assert objectives.average_precision(none, [3.0, 2.0, 1.0]) == 0
    assert objectives.purity([-1, -1], [0, 0]) == 0
    assert objectives.head_in_cluster(none, [-1, -1, -1], [0, 0, 0]) == 0


@settings(max_examples=50)
@given(UAVS, st.data())
def test_average_precision_is_that_of_scikit_learn(uavs, data):
    head = data.draw(hnp.arrays(bool, uavs))
    head[data.draw(st.integers(0, uavs - 1))] = True
    ties_and_others = st.one_of(st.integers(-2, 2).map(float), st.floats(-1e6, 1e6))
    scores = data.draw(hnp.arrays(np.float64, uavs, elements=ties_and_others) | hnp.arrays(np.uint8, uavs))
    assert objectives.average_precision(head, scores) == average_precision_score(head, scores)


@given(clusterings())
def test_purity_is_the_share_of_the_largest_classes(clustering):
    _, leader, labels = clustering
    counted = [i for i in range(len(leader)) if leader[i] >= 0]
    right = 0
    for k in {labels[i] for i in counted if labels[i] >= 0}:
        members = [leader[i] for i in counted if labels[i] == k]
        right += max(members.count(j) for j in members)
    assert objectives.purity(leader, labels) == (right / len(counted) if counted else 0)


@given(clusterings())
def test_a_head_is_in_its_cluster_where_most_of_its_followers_are(clustering):
    head, leader, labels = clustering
    answers = []
    for chief in as_set(head):
        followers = [labels[i] for i in range(len(head)) if leader[i] == chief and i != chief]
        if followers:
            placed = [label for label in followers if label >= 0]
            most = max((placed.count(label) for label in placed), default=0)
            answers.append(labels[chief] >= 0 and most > 0 and placed.count(labels[chief]) == most)
    expected = sum(answers) / len(answers) if answers else 0
    assert objectives.head_in_cluster(head, leader, labels) == pytest.approx(expected)


@given(st.integers(1, 12).flatmap(lambda uavs: hnp.arrays(np.int64, uavs, elements=st.integers(-1, uavs - 1))))
def test_roots_end_the_chains_of_leaders(leader):
    for i, root in enumerate(objectives.find_roots(leader)):
        chain = [i]
        while leader[chain[-1]] >= 0 and leader[chain[-1]] != chain[-1] and len(chain) <= len(leader):
            chain.append(leader[chain[-1]])
        assert root == (chain[-1] if len(chain) <= len(leader) else -1)


def test_the_leader_of_a_known_group_has_its_highest_score():
    """0 leads 1 and 2, 1 leads 3; 4 leads 5; 6 is alone."""
    truth = np.array([0, 0, 0, 1, 4, 4, -1])
    assert objectives.group_leader_accuracy(truth, [2, 1, 1, 1, 0, 5, 9]) == 1 / 2
    assert objectives.group_leader_accuracy(truth, np.zeros(7)) == (1 / 4 + 1 / 2) / 2
    assert objectives.group_leader_accuracy([-1, -1], [0, 1]) == 0


def test_followers_are_behind_a_head_in_its_tree_or_else_in_its_cluster():
    """A candidate follows no UAV, whatever leader the detector gives it."""
    candidates, scores = np.array([1, 0, 0, 1, 0]), np.zeros(5)
    tree = Detection(candidates, scores, leader=[3, 0, 1, -1, 3], clusters=[0, 0, 0, 0, 0])
    assert [objectives.list_followers(tree, head) for head in (0, 3)] == [[1, 2], [4]]
    groups = Detection(candidates, scores, clusters=[0, 0, -1, 1, 1])
    assert [objectives.list_followers(groups, head) for head in (0, 2, 3)] == [[1], [], [4]]
    assert objectives.list_followers(Detection(candidates, scores), 0) == []
