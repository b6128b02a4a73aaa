"""neural-granger as a detector: its answers, what it must not change, and the arguments that it refuses."""

import random

import numpy as np
import pytest
import torch
from single_cluster_windows import changed, cluster, clusters, named, without
from sklearn.base import clone

from detectors.neural_granger import NeuralGranger
from usnet_env import ArgumentError, Window, evaluate, make_detector

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


def rate(found, heads):
    return float((named(found) == heads).mean())


def same(one, two):
    for name in ("candidates", "scores", "leader", "attention"):
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name))
    assert one.extras.keys() == two.extras.keys()
    for name, value in one.extras.items():
        np.testing.assert_array_equal(value, two.extras[name])


# the candidates


@pytest.mark.parametrize("follow", ["f1", "f4"])
@quick_and_slow(12)
def test_finds_the_head(follow, count, arguments):
    windows, heads = clusters(count, follow=follow, followers=4)
    assert rate(detector(**arguments).detect_batch(windows), heads) == 1.0


@pytest.mark.parametrize("follow", ["f4", "f5"])
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


@pytest.mark.parametrize("follow", ["f1", "f4"])
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
    turned = [
        changed(w, position=w.position[:, order], velocity=w.velocity[:, order], seen=w.seen[:, order]) for w in windows
    ]
    before, after = detector(**arguments).detect_batch(windows), detector(**arguments).detect_batch(turned)
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


@pytest.mark.parametrize("top_k", [1, 3, 50])
def test_top_k(top_k):
    window, _ = cluster(followers=4)
    got = detector(top_k=top_k, **FEW).detect(window)
    assert got.candidates.sum() == min(top_k, 5)
    if top_k == 3:
        assert got.scores[got.candidates].min() >= got.scores[~got.candidates].max()


# masks and subsets


def test_destroyed_uavs_are_left_out():
    window, head = cluster(followers=6)
    gone = [i for i in range(7) if i != head][1:3]
    got = detector(top_k=7, **FEW).detect(without(window, gone))
    assert not got.candidates[gone].any()
    assert got.candidates.sum() == 5
    assert (got.scores[gone] == 0).all()
    assert (got.attention[gone] == 0).all()
    assert (got.attention[:, gone] == 0).all()
    assert (got.leader[gone] == -1).all()
    assert not np.isin(got.leader, gone).any()
    np.testing.assert_allclose(np.delete(got.attention, gone, axis=0).sum(axis=1), 1.0, atol=1e-5)


def test_finds_the_head_of_the_living_uavs():
    windows, heads = clusters(3, followers=6)
    left = [
        without(window, [i for i in range(7) if i != head][:2]) for window, head in zip(windows, heads, strict=True)
    ]
    np.testing.assert_array_equal(named(detector(**SHORT).detect_batch(left)), heads)


def test_values_that_were_not_seen_are_not_read():
    window, _ = cluster(followers=4, miss_rate=0.2)
    gone = without(window, [1])
    noise = np.random.default_rng(0)
    there = gone.seen & gone.alive
    dirty = changed(
        gone,
        position=np.where(there[..., None], gone.position, noise.normal(size=gone.position.shape)),
        velocity=np.where(gone.velocity_seen[..., None], gone.velocity, noise.normal(size=gone.velocity.shape)),
    )
    same(detector(**FEW).detect(gone), detector(**FEW).detect(dirty))


def test_a_uav_that_lives_but_was_never_seen():
    window, head = cluster(followers=5)
    hidden = (head + 1) % 6
    seen = window.seen.copy()
    seen[:, hidden] = False
    there = seen[1:] & seen[:-1]
    unseen = changed(
        window,
        position=np.where(seen[..., None], window.position, 0),
        velocity=np.where(there[..., None], window.velocity, 0),
        seen=seen,
    )
    got = detector(**SHORT).detect(unseen)
    assert named([got]) == [head]
    assert got.scores[hidden] == 0 or np.isfinite(got.scores[hidden])


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


@pytest.mark.parametrize("alive", [1, 2])
def test_one_or_two_living_uavs_give_no_evidence(alive):
    window, _ = cluster(followers=4)
    left = without(window, list(range(5 - alive)))
    picked = {int(named([detector(seed).detect(left)])[0]) for seed in range(20)}
    assert picked == set(range(5 - alive, 5))
    assert not detector(gate=True).detect(left).candidates.any()


# batches, generators and threads


def test_the_same_seed_gives_the_same_answers():
    windows, _ = clusters(3, followers=3)
    first, second = (detector(7, **FEW).detect_batch(windows) for _ in range(2))
    for one, two in zip(first, second, strict=True):
        same(one, two)
    other = detector(8, **FEW).detect_batch(windows)
    assert any((one.attention != two.attention).any() for one, two in zip(first, other, strict=True))


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


def test_nothing_global_is_touched():
    windows, _ = clusters(2, followers=3)

    def world():
        kind, keys, *rest = np.random.get_state()  # noqa: NPY002  the generator that must stay untouched
        return (
            torch.get_rng_state().tolist(),
            (kind, keys.tolist(), rest),
            random.getstate(),
            torch.get_num_threads(),
            torch.get_num_interop_threads(),
            torch.get_default_dtype(),
            torch.is_grad_enabled(),
            torch.are_deterministic_algorithms_enabled(),
        )

    before = world()
    detector(**FEW).detect_batch(windows)
    NeuralGranger(**FEW).detect(windows[0])  # without a reset it has a generator of its own as well
    assert world() == before


def test_the_window_is_left_as_it_is():
    window, _ = cluster(followers=3)
    kept = window.position.copy(), window.velocity.copy()
    detector(**FEW).detect(window)
    np.testing.assert_array_equal(window.position, kept[0])
    np.testing.assert_array_equal(window.velocity, kept[1])


# scikit-learn's rule, names, and the referee


def test_arguments_are_stored_and_cloned():
    made = NeuralGranger(top_k=2, gate=True, learning_rate=0.01)
    arguments = made.get_params()
    assert (arguments["gate"], arguments["learning_rate"]) == (True, 0.01)
    assert arguments["steps"] is None
    copy = clone(made)
    assert copy.get_params() == arguments
    assert copy.set_params(top_k=3).top_k == 3
    assert made.top_k == 2
    assert "rng" not in vars(made)


def test_by_name():
    made = make_detector("neural-granger(gate=False, steps=3)", top_k=2)
    assert isinstance(made, NeuralGranger)
    assert (made.gate, made.steps, made.top_k) == (False, 3, 2)
    made.reset(0)
    assert made.detect(cluster(followers=3)[0]).candidates.sum() == 2


def test_plays_with_the_referee():
    arguments = {"follow": "f4", "followers": 3}
    result = evaluate("USNET/SingleCluster-v0", "neural-granger(steps=60)", episodes=2, env_kwargs=arguments)
    assert result["neural-granger(steps=60)"]["success"]["mean"] == 1.0
    assert result["neural-granger(steps=60)"]["J"]["mean"] == 0.0


def test_one_cluster_of_the_multi_cluster_world():
    result = evaluate(
        "USNET/MultiCluster-v0", "neural-granger(steps=60)", episodes=2, env_kwargs={"clusters": 1, "uavs": 5}
    )
    assert result["neural-granger(steps=60)"]["J"]["mean"] == 1.0


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


@pytest.mark.parametrize(
    ("arguments", "argument"),
    [
        ({"top_k": 0}, "top_k"),
        ({"top_k": 1.5}, "top_k"),
        ({"top_k": True}, "top_k"),
        ({"gate": 1}, "gate"),
        ({"gate_threshold": -0.1}, "gate_threshold"),
        ({"gate_threshold": float("nan")}, "gate_threshold"),
        ({"gate_threshold": "high"}, "gate_threshold"),
        ({"device": "tpu"}, "device"),
        ({"device": 0}, "device"),
        ({"memory": 0}, "memory"),
        ({"memory": "4"}, "memory"),
        ({"steps": 0}, "steps"),
        ({"steps": "many"}, "steps"),
        ({"times": 2.5}, "times"),
        ({"learning_rate": 0.0}, "learning_rate"),
        ({"learning_rate": float("inf")}, "learning_rate"),
        ({"weight_decay": -1.0}, "weight_decay"),
        ({"input_noise": None, "voters": 1}, "voters"),
        ({"units": 0}, "units"),
        ({"blocks": 0}, "blocks"),
        ({"ridge": 0.0}, "ridge"),
        ({"floor": -1.0}, "floor"),
    ],
)
def test_an_argument_is_refused_in_one_sentence(arguments, argument):
    window, _ = cluster(followers=2)
    for act in (lambda: NeuralGranger(**arguments).reset(0), lambda: NeuralGranger(**arguments).detect(window)):
        with pytest.raises(ArgumentError) as refused:
            act()
        sentence = str(refused.value)
        assert sentence.startswith(f"{argument} must ")
        assert sentence.endswith(".")
        assert "\n" not in sentence
        assert "got " in sentence


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


def test_a_window_that_is_too_short_is_refused():
    window, _ = cluster(followers=4)
    short = changed(window, position=window.position[:5], velocity=window.velocity[:4], seen=window.seen[:5])
    sentence = r"^window must hold more than memory = 4 velocities, got 4\.$"
    with pytest.raises(ArgumentError, match=sentence):
        detector().detect(short)
    with pytest.raises(ArgumentError, match=sentence):
        detector().detect_batch([window, short])


def test_windows_that_show_nothing():
    window, _ = cluster(followers=4)
    two = changed(
        window, position=window.position[:, :2], velocity=window.velocity[:, :2], seen=window.seen[:, :2], alive=[1, 1]
    )
    unseen = changed(window, seen=np.zeros_like(window.seen))
    for poor in (two, unseen):
        found = detector(**FEW).detect_batch([poor, window, poor])
        assert [answer.candidates.sum() for answer in found] == [1, 1, 1]
        assert not found[0].scores.any()
        assert found[1].scores.any()
        assert not detector(gate=True).detect(poor).candidates.any()
    answer = detector().detect(without(window, list(range(5))))
    assert not answer.candidates.any()


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


@pytest.mark.parametrize("steps", [5, 6, 12])
def test_the_shortest_windows(steps):
    window, _ = cluster(followers=2)
    short = Window(
        window.position[: steps + 1], window.velocity[:steps], window.seen[: steps + 1], window.alive, window.round
    )
    got = detector(**FEW).detect(short)
    assert got.candidates.sum() == 1
    assert np.isfinite(got.extras["explained"]).all()


@pytest.mark.slow
def test_five_hundred_uavs():
    window, _ = cluster(followers=499)
    got = detector(steps=2).detect(window)
    assert got.attention.shape == (500, 500)
    assert got.candidates.sum() == 1
