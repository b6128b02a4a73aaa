"""What lead-votes and MC-GASSL have in common."""

import numpy as np
import pytest
from swarm_games import game, part_of

from detectors.lead_votes import LeadVotes
from detectors.mc_gassl import McGassl
from detectors.neural_granger import NeuralGranger

QUICK = {
    LeadVotes: {"head_detector": NeuralGranger(steps=3, times=8, voters=4), "gate_steps": 3, "passes": 1},
    McGassl: {"gassl": {"steps": 2}},
}


@pytest.mark.parametrize("kind", QUICK)
@pytest.mark.parametrize("alive", [0, 1, 2])
def test_fewer_than_three_living_uavs(kind, alive):
    some = np.arange(14) < alive
    detector = kind(**QUICK[kind])
    detector.reset(0)
    answer = detector.detect(part_of(game()[1], some))
    assert answer.candidates.sum() == min(1, alive)
    assert not (answer.candidates & ~some).any()


@pytest.mark.parametrize("kind", QUICK)
def test_the_seed_decides(kind):
    _, window = game()
    answers = []
    for _ in range(2):
        detector = kind(**QUICK[kind])
        detector.reset(7)
        answers.append(detector.detect(window))
    for field in ("candidates", "scores", "clusters", "leader", "attention"):
        np.testing.assert_array_equal(getattr(answers[0], field), getattr(answers[1], field))


@pytest.mark.parametrize("kind", QUICK)
@pytest.mark.parametrize("bad", ["k-means", 3])
def test_a_bad_clusterer_is_refused(kind, bad):
    sentence = "clusterer must be one of" if isinstance(bad, str) else "clusterer must be a name or have cluster"
    with pytest.raises(ValueError, match=f"^{sentence}"):
        kind(clusterer=bad).reset(0)
