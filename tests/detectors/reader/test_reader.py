"""The reader as a detector, with an untrained network; its network without torch, and refused weights."""

import numpy as np
import pytest
import torch
from single_cluster_windows import without
from synthetic_windows import swarm_window

from detectors.checks import check_detector
from detectors.reader import Reader
from detectors.reader.features import CONTEXT_FEATURES, PAIR_FEATURES, UAV_FEATURES, Features
from detectors.reader.forward import load_reader, predict
from detectors.reader.network import NetworkSizes, draw_network
from detectors.weights import read_arrays, write_weights
from usnet_env.config import ArgumentError

SIMPLE = {"follow": "f1", "memory": 12}


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    arrays = draw_network(NetworkSizes(), 3).state_dict()
    return str(write_weights(tmp_path_factory.mktemp("reader") / "reader.safetensors", arrays, {}, {}))


@pytest.fixture(scope="module")
def reader(weights):
    made = Reader(weights=weights)
    made.reset(0)
    return made


def test_the_reader_is_a_detector(weights):
    check_detector(Reader(weights=weights))


def test_an_answer_says_who_leads_whom_and_how_surely(reader):
    window, _ = swarm_window(1, **SIMPLE)
    answer = reader.detect(without(window, [3, 4], unseen=[7]))
    p, extras = answer.extras["probability"], answer.extras
    read = ~np.isin(np.arange(30), [3, 4, 7])
    pairs = read[:, None] & read & ~np.eye(30, dtype=bool)
    assert np.array_equal((answer.attention > 0) & (answer.attention < 1), pairs)  # probabilities of links
    assert not answer.attention[~pairs].any()
    for values in (answer.leader, answer.clusters, extras["root"]):
        assert np.array_equal(values >= 0, read)
    assert not p[~read].any()
    assert 0 < extras["p_no_leader"] < 1
    assert extras["confidence"] == pytest.approx(np.maximum(p, 1 - p).prod())
    assert not extras["delay"][answer.leader == np.arange(30)].any()
    assert len(set(answer.clusters[read])) == len(set(extras["root"][read]))


def test_nothing_seen_means_nobody_leads(reader):
    window, _ = swarm_window(1, **SIMPLE)
    answer = reader.detect(without(window, [], unseen=range(30)))
    assert not answer.candidates.any()
    assert answer.extras["p_no_leader"] == 1.0


SMALL = NetworkSizes(width=8, attn_heads=2, blocks=2)


def draw_features(n, seed=0):
    rng = np.random.default_rng(seed)
    shapes = (n, n, PAIR_FEATURES), (n, UAV_FEATURES), (CONTEXT_FEATURES,)
    return Features(*(rng.normal(scale=4.0, size=shape).astype(np.float32) for shape in shapes))


def draw_trained_network(sizes):
    """A network of which no array is trivial, and whose logits are as large as after a training."""
    network, generator = draw_network(sizes, 1), torch.Generator().manual_seed(2)
    with torch.no_grad():
        for array in network.state_dict().values():
            array += 0.1 * torch.randn(array.shape, generator=generator)
    return network


def answer(network, *windows):
    with torch.no_grad():
        return network(*(torch.from_numpy(np.stack(arrays)) for arrays in zip(*windows, strict=True)))


@pytest.mark.parametrize(("n", "sizes"), [(1, SMALL), (2, SMALL), (7, SMALL), (40, NetworkSizes())])
def test_answers_without_torch_are_those_of_torch(tmp_path, n, sizes):
    network, windows = draw_trained_network(sizes), [draw_features(n, seed) for seed in range(2)]
    path = write_weights(tmp_path / "reader.safetensors", network.state_dict(), {}, {})
    wanted, weights = answer(network, *windows), load_reader(str(path))
    assert n == 1 or np.ptp(wanted.leader.numpy()) > 0.5
    for k, features in enumerate(windows):
        for name, got in predict(weights, features)._asdict().items():
            assert got.dtype == np.float32
            want = getattr(wanted, name)[k].numpy()
            assert got.shape == want.shape
            np.testing.assert_allclose(got, want, rtol=0, atol=1e-5, err_msg=name)


def test_a_permutation_of_uavs_permutes_the_answer():
    weights = {name: array.numpy() for name, array in draw_trained_network(SMALL).state_dict().items()}
    features, order = draw_features(9), np.random.default_rng(3).permutation(9)
    mixed = Features(features.pair[np.ix_(order, order)], features.uav[order], features.context)
    whole, turned = predict(weights, features), predict(weights, mixed)
    for name in ("head", "delay"):
        np.testing.assert_allclose(getattr(turned, name), getattr(whole, name)[order], atol=1e-5)
    for name in ("leader", "root", "link"):
        np.testing.assert_allclose(getattr(turned, name), getattr(whole, name)[np.ix_(order, order)], atol=1e-5)
    np.testing.assert_allclose(turned.silent, whole.silent, atol=1e-5)
    assert np.ptp(whole.head) > 0.1


def test_one_outlier_among_inputs_has_a_bound():
    network, features = draw_trained_network(SMALL), draw_features(5)
    far, further = features.pair.copy(), features.pair.copy()
    far[1, 2], further[1, 2] = 1e3, 1e6
    answers = [answer(network, features._replace(pair=pair)) for pair in (far, further)]
    assert torch.equal(answers[0].head, answers[1].head)


def test_gradients_reach_every_parameter():
    network, features = draw_trained_network(SMALL), draw_features(6)
    sum(part.square().sum() for part in network(*(torch.from_numpy(array)[None] for array in features))).backward()
    assert [name for name, array in network.named_parameters() if not array.grad.abs().max() > 0] == []


def test_foreign_weights_are_refused(tmp_path):
    with pytest.raises(ArgumentError, match=r"^path must be a safetensors file, got .*none'"):
        load_reader(str(tmp_path / "none"))
    arrays = {"pair_mean": np.zeros(3, np.float32), "uav_mean": np.zeros(2, np.float32)}
    path = write_weights(tmp_path / "other.safetensors", arrays, {}, {})
    with pytest.raises(ArgumentError, match=r"^weights must be a file of a reader with this version's features, got"):
        load_reader(str(path))
    with pytest.raises(ArgumentError, match=r"^attn_heads must divide width \(32\), got 3"):
        draw_network(NetworkSizes(attn_heads=3), 0)


def test_arrays_are_read_as_they_were_written_in_any_order_of_memory(tmp_path):
    grid = np.arange(12, dtype=np.float32).reshape(3, 4)
    arrays = {"fortran": np.asfortranarray(grid), "part": grid[::2, ::3], "tensor": torch.from_numpy(grid).T}
    arrays |= {"number": np.float64(2.5)}
    read = read_arrays(write_weights(tmp_path / "some.safetensors", arrays, {}, {}))
    for name, array in arrays.items():
        np.testing.assert_array_equal(read[name], np.asarray(array), strict=True)
