"""neural-granger as a detector: its answers, what it must not change, and the arguments that it refuses."""

import numpy as np
import pytest
import torch
from single_cluster_windows import changed, cluster, clusters, named, rate, renumbered, same, without

from detectors.neural_granger import NeuralGranger
from usnet_env import ArgumentError, evaluate

FEW = {"steps": 5}  # for tests in which the candidate does not matter
SHORT = {"steps": 60}  # enough for an easy head


def quick_and_slow(count):
    """A test with six windows and few training steps, and as a slow test with ``count`` windows and the defaults."""
    return pytest.mark.parametrize(
        ("count", "arguments"), [(6, SHORT), pytest.param(count, {}, marks=pytest.mark.slow)]
    )


def detector(seed=0, **arguments):
    made = NeuralGranger(**arguments)
    made.reset(seed)
    return made


# the candidates


@pytest.mark.parametrize("follow", [pytest.param("f1", marks=pytest.mark.slow), "f4"])
@quick_and_slow(12)
def test_finds_the_head(follow, count, arguments):
    windows, heads = clusters(count, follow=follow, followers=4)
    assert rate(detector(**arguments).detect_batch(windows), heads) == 1.0


@pytest.mark.parametrize("follow", ["f4", pytest.param("f5", marks=pytest.mark.slow)])
@quick_and_slow(40)
def test_a_decoy_is_not_named(follow, count, arguments):
    windows, heads = clusters(count, follow=follow, followers=2, decoys=1)
    found = detector(**arguments).detect_batch(windows)
    assert rate(found, heads) >= 0.95


@pytest.mark.slow
@pytest.mark.parametrize("follow", [f"f{k}" for k in range(1, 8)])
@pytest.mark.parametrize("followers", [2, 5])
def test_names_the_head_beside_a_decoy(follow, followers):
    windows, heads = clusters(100, follow=follow, followers=followers, decoys=1)
    assert rate(detector().detect_batch(windows), heads) >= 0.95


@quick_and_slow(20)
def test_missing_samples(count, arguments):
    windows, heads = clusters(count, followers=4, miss_rate=0.2)
    assert rate(detector(**arguments).detect_batch(windows), heads) >= 0.8


@quick_and_slow(20)
def test_the_gate_names_no_uav_where_none_is_followed(count, arguments):
    # Without followers every UAV moves by itself; the head of the environment flies like all others.
    windows, _ = clusters(count, follow="none", followers=4)
    gated = detector(gate=True, **arguments).detect_batch(windows)
    assert np.mean(named(gated) == -1) >= 0.95
    for detection in gated:
        assert detection.extras["followed"] == detection.candidates.any()
    assert (named(detector(**arguments).detect_batch(windows)) >= 0).all()  # without the gate, the best guess


@pytest.mark.parametrize("follow", [pytest.param("f1", marks=pytest.mark.slow), "f4"])
@quick_and_slow(12)
def test_the_gate_lets_a_head_through(follow, count, arguments):
    windows, heads = clusters(count, follow=follow, followers=3)
    assert rate(detector(gate=True, **arguments).detect_batch(windows), heads) == 1.0


@quick_and_slow(20)
def test_the_smallest_cluster(count, arguments):
    windows, heads = clusters(count, followers=2)
    assert windows[0].uavs == 3
    assert rate(detector(**arguments).detect_batch(windows), heads) >= 0.95


@quick_and_slow(20)
def test_no_index_is_favoured(count, arguments):
    """Renumbering the UAVs renumbers the answer: the head is found at whatever index it sits, by as many votes."""
    windows, heads = clusters(count, followers=3)
    order = np.array([2, 0, 3, 1])
    before = detector(**arguments).detect_batch(windows)
    after = detector(**arguments).detect_batch(renumbered(windows, order))
    np.testing.assert_array_equal(order[named(after)], named(before))
    assert rate(before, heads) == 1.0
    scores = np.array([d.scores for d in before])[:, order] - np.array([d.scores for d in after])
    assert abs(scores.mean(axis=0)).max() < 0.05


def test_guesses_without_evidence_favour_no_index():
    windows, _ = clusters(150, follow="none", followers=2)
    counts = np.bincount(named(detector(**FEW).detect_batch(windows)), minlength=3)
    assert (np.abs(counts - 50) < 5 * np.sqrt(50 * 2 / 3)).all()


# the shape of an answer


def test_shapes_and_ranges():
    window, _ = cluster(followers=4)
    got = detector(**FEW).detect(window)
    assert got.candidates.shape == got.scores.shape == (5,)
    assert got.candidates.sum() == 1
    assert got.scores[got.candidates] == got.scores.max()
    assert got.attention.shape == (5, 5)
    np.testing.assert_allclose(got.attention.sum(axis=1), 1.0, atol=1e-5)
    np.testing.assert_array_equal(got.extras["choice"], got.attention.argmax(axis=1))
    others = got.attention - 2 * np.eye(5)
    np.testing.assert_array_equal(got.leader, others.argmax(axis=1))
    assert got.extras["explained"].shape == (5,)
    assert got.extras["explained"].max() <= 1
    assert (got.scores >= 0).all()
    assert got.scores.sum() <= 1 + 1e-6
    votes = [sum(got.attention[other, i] for other in range(5) if other != i) / 5 for i in range(5)]
    np.testing.assert_allclose(got.scores, votes)
    assert got.extras["gain"].shape == (5,)
    assert isinstance(got.extras["followed"], bool)


@pytest.mark.parametrize("memory", [1, 2])
def test_another_memory(memory):
    window, _ = cluster(followers=3)
    assert detector(memory=memory, **FEW).detect(window).candidates.sum() == 1


def test_what_is_explained():
    """A rate gained while predicting nothing is visible: followers are explained, a UAV that moves at random is not."""
    windows, heads = clusters(3, follow="f1", followers=4, decoys=1)
    for window, head, got in zip(windows, heads, detector(**SHORT).detect_batch(windows), strict=True):
        followers = np.flatnonzero(got.leader == head)
        assert len(followers) >= 4
        explained = np.sort(got.extras["explained"])
        assert (explained[-4:] > 0.6).all()
        assert got.extras["explained"][head] < 0.3
        assert window.uavs == len(explained) == 6


# masks and subsets


def test_finds_the_head_of_the_living_uavs():
    windows, heads = clusters(3, followers=6)
    left = [
        without(window, [i for i in range(7) if i != head][:2]) for window, head in zip(windows, heads, strict=True)
    ]
    np.testing.assert_array_equal(named(detector(**SHORT).detect_batch(left)), heads)


def test_a_part_of_the_swarm():
    windows, heads = clusters(2, followers=7)
    window, head = windows[0], heads[0]
    members = np.zeros(8, bool)
    members[[head, (head + 2) % 8, (head + 3) % 8, (head + 5) % 8]] = True
    found = detector(**FEW).detect_among(window, members)
    assert not found.candidates[~members].any()
    assert (found.attention[~members] == 0).all()
    same(found, detector(**FEW).detect(without(window, np.flatnonzero(~members))))
    assert named([detector(**SHORT).detect_among(window, members)]) == [head]


# batches, generators and threads


def test_a_batch_of_one_is_one_window():
    window, _ = cluster(followers=3)
    same(detector(**FEW).detect(window), detector(**FEW).detect_batch([window])[0])


def test_a_batch_keeps_its_order_over_sizes_and_lengths():
    sizes = [4, 2, 4, 3, 2]
    pairs = [cluster(seed, followers=followers) for seed, followers in enumerate(sizes)]
    short = cluster(9, followers=4, observation_steps=70)
    pairs.insert(2, short)
    pairs.append((without(pairs[0][0], [0, 1, 2]), None))
    found = detector(**SHORT).detect_batch([window for window, _ in pairs])
    for (window, head), got in zip(pairs, found, strict=True):
        assert len(got.candidates) == window.uavs
        if head is not None:
            assert named([got]) == [head]
    assert detector().detect_batch([]) == []


def test_windows_of_a_batch_do_not_change_each_other_but_by_the_draws():
    """The first window of a batch gets the same answer whatever the second shows."""
    first, _ = cluster(0, followers=3)
    second, third = cluster(1, followers=3)[0], cluster(2, followers=3)[0]
    one, two = (detector(**FEW).detect_batch([first, other])[0] for other in (second, third))
    np.testing.assert_allclose(one.attention, two.attention, atol=1e-5)


# scikit-learn's rule, names, and the referee


@pytest.mark.parametrize(
    ("env", "arguments", "best"),
    [("SingleCluster", {"follow": "f4", "followers": 3}, 0.0), ("MultiCluster", {"clusters": 1, "uavs": 5}, 1.0)],
)
def test_plays_with_the_referee(env, arguments, best):
    made = detector(**SHORT)
    (summary,) = evaluate(f"USNET/{env}-v0", made, episodes=2, env_kwargs=arguments, isolate=False).summary
    assert summary["metrics"]["success"]["mean"] == 1.0
    assert summary["metrics"]["J"]["mean"] == best


def test_as_a_policy():
    window, head = cluster(followers=3)
    observation = {
        "position": window.position,
        "velocity": window.velocity,
        "seen": window.seen.astype(np.int8),
        "alive": window.alive.astype(np.int8),
        "round": np.ones(1, np.float32),
    }
    action, _ = NeuralGranger(**SHORT).as_policy().predict(observation)
    assert action.tolist() == [int(i == head) for i in range(4)]


# what is refused


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_a_gpu_that_is_not_there():
    with pytest.raises(ArgumentError, match=r"^device must be 'cpu' or 'auto' on .*, got 'cuda'\.$"):
        NeuralGranger(device="cuda").reset(0)
    window, head = cluster(followers=2)
    assert named([detector(device="auto", **SHORT).detect(window)]) == [head]


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
def test_on_a_gpu():
    windows, heads = clusters(8, followers=4, follow="f3")
    found = detector(device="cuda").detect_batch(windows)
    again = detector(device="auto").detect_batch(windows)
    assert rate(found, heads) >= 0.75
    for one, two in zip(found, again, strict=True):
        np.testing.assert_allclose(one.scores, two.scores, atol=0.25)


def test_the_gate_names_no_uav_of_windows_that_show_nothing():
    window, _ = cluster(followers=4)
    two, unseen = without(window, [0, 1, 2]), changed(window, seen=np.zeros_like(window.seen))
    for poor in (two, unseen):
        found = detector(**FEW).detect_batch([poor, window, poor])
        assert [answer.candidates.sum() for answer in found] == [1, 1, 1]
        assert not found[0].scores.any()
        assert found[1].scores.any()
        assert not detector(gate=True).detect(poor).candidates.any()


def test_a_window_with_nan_is_refused_at_the_border():
    window, _ = cluster(followers=2)
    broken = window.velocity.copy()
    broken[3, 1, 0] = np.nan
    with pytest.raises(ArgumentError, match=r"^velocity must be finite, got NaN or infinity\.$"):
        changed(window, velocity=broken)


@pytest.mark.parametrize("members", [np.ones(4, bool), np.ones(3, int), None, [True, False]])
def test_members_that_are_refused(members):
    window, _ = cluster(followers=2)
    with pytest.raises(ArgumentError, match=r"^members must be 3 booleans, got .*\.$"):
        detector().detect_among(window, members)
