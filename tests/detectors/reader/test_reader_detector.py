"""The reader as a detector, with an untrained network: shapes, ranges, order, gaps, sizes; it doesn't need torch."""

import numpy as np
import pytest
from synthetic_windows import swarm_window

from detectors.checks import check_detector
from detectors.reader import Reader
from detectors.reader.network import NetworkSizes, draw_network
from detectors.weights import write_weights
from usnet_env import ArgumentError, Window

SIMPLE = {"follow": "f1", "memory": 12}


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    """The path of a file with random weights."""
    arrays = draw_network(NetworkSizes(), 3).state_dict()
    return str(write_weights(tmp_path_factory.mktemp("reader") / "reader.safetensors", arrays, {}, {}))


@pytest.fixture(scope="module")
def reader(weights):
    made = Reader(weights=weights)
    made.reset(0)
    return made


def hide(window, gone=(), unseen=()):
    """The window without destroyed and unseen UAVs."""
    seen, alive = np.array(window.seen), np.array(window.alive)
    alive[list(gone)], seen[:, [*gone, *unseen]] = False, False
    both = seen[1:] & seen[:-1]
    return Window(window.position * seen[..., None], window.velocity * both[..., None], seen, alive)


def test_the_reader_is_a_detector(weights):
    check_detector(Reader(weights=weights))


def test_an_answer_says_who_leads_whom_and_how_surely(reader):
    window, _ = swarm_window(1, **SIMPLE)
    answer = reader.detect(hide(window, gone=[3, 4], unseen=[7]))
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
    answer = reader.detect(hide(window, unseen=range(30)))
    assert not answer.candidates.any()
    assert answer.extras["p_no_leader"] == 1.0


def test_other_weights_and_arguments_are_refused(tmp_path):
    (tmp_path / "broken.safetensors").write_bytes(b"nothing")
    for wrong in ({"weights": str(tmp_path / "broken.safetensors")}, {"policy": "threshold"}, {"round_price": 0.0}):
        with pytest.raises(ArgumentError):
            Reader(**wrong).reset(0)


def test_an_answer_needs_no_torch(fresh_process, weights):
    said = fresh_process.run(
        "import sys; sys.modules['torch'] = None\n"
        "import numpy as np; from usnet_env import Window; from detectors.reader import Reader\n"
        "v = np.random.default_rng(0).standard_normal((9, 4, 3)); p = np.append(np.zeros((1, 4, 3)), v.cumsum(0), 0)\n"
        "w = Window(p, v, np.ones((10, 4), bool), np.ones(4, bool))\n"
        f"print(len(Reader(weights={weights!r}).detect(w).scores))"
    )
    assert said.strip() == "4"
