"""Single UAVs: evidence by the law of the other followers against a slow definition, and the heads that they make."""

import numpy as np
import pytest
from mixture_windows import answer

from detectors.follow_mixture.delays import compare_delays
from detectors.follow_mixture.evidence import RARE, gather_statistics, make_targets, own_evidence, pair
from detectors.follow_mixture.motion import lagged
from detectors.follow_mixture.pooling import ask_single_uavs
from usnet_env import Window

NAMES = ("v(1)", "v(L)")
LAGS = 2


def make_swarm(seed, followers, copied=0.25, steps=100, others=8):
    """Velocities ``(n, steps, 3)``: UAV 0 is copied one step later, with much noise; others fly alone."""
    rng = np.random.default_rng(seed)
    velocity = rng.normal(size=(1 + followers + others, steps, 3))
    velocity[1 : 1 + followers, 1:] += copied * velocity[0, :-1]
    return velocity


def compare(velocity, heads=()):
    """Targets, pairs and evidence ``(K, P)`` of all UAVs as single ones."""
    targets = make_targets(velocity, np.arange(len(velocity)), LAGS)
    past = lagged(velocity, LAGS)
    head = np.full(len(velocity), -1)
    head[: len(heads)] = heads  # so that they are asked
    lone = ask_single_uavs(targets, past, NAMES, head, pair(*np.zeros((2, 0), int)), np.zeros(0))
    classes = gather_statistics(targets, past, lone.single, NAMES)
    own = (own_evidence(targets, lone.single, some) for some in classes)
    found = [lone.compare(targets, lone.single, *each) for each in zip(classes, own, strict=True)]
    return targets, past, lone, classes, np.array(found)


def fit(velocity):
    """The detection of a window with these velocities ``(n, steps, 3)``."""
    flown = velocity.swapaxes(0, 1)
    position = np.concatenate([np.zeros((1, *flown.shape[1:])), np.cumsum(flown, axis=0)])
    seen, alive = np.ones(position.shape[:2], bool), np.ones(len(velocity), bool)
    window = Window(position.astype(np.float32), flown.astype(np.float32), seen, alive)
    return answer(window, memory=LAGS, policy="map")


def test_a_follower_gains_by_the_law_of_the_others():
    """The law of each follower's gain is a regression on all other followers, shrunk by what chance explains."""
    velocity = make_swarm(0, followers=12, copied=0.6)
    targets, past, lone, _, evidence = compare(velocity, heads=[0])
    followers = np.arange(1, 13)
    weight = 3.0 * targets.rows / targets.energy
    features = past[0, 0].T - past[0, 0].mean(axis=1)

    def residual(uav, values):
        values = values * targets.weight[uav][:, None]
        return values - targets.own[uav].T @ (targets.own[uav] @ values)

    for uav in followers:
        design = np.concatenate([residual(k, features) * np.sqrt(weight[k]) for k in followers if k != uav])
        target = np.concatenate([targets.innovation[k].T * np.sqrt(weight[k]) for k in followers if k != uav])
        law = np.linalg.lstsq(design, target, rcond=None)[0]
        explained = ((design @ law) ** 2).sum()
        law *= 1.0 - 9.0 / explained
        left = ((targets.innovation[uav].T - residual(uav, features) @ law) ** 2).sum()
        expected = -1.5 * targets.rows[uav] * np.log(left / (targets.innovation[uav] ** 2).sum())
        (place,) = np.flatnonzero((lone.single.group == uav) & (lone.single.uav == 0))
        assert expected > 5.0  # so that all are followers in the definition, too
        assert evidence[0, place] == pytest.approx(expected, rel=0.02, abs=0.1)


def test_followers_that_no_regression_finds_alone_are_found_together():
    heads = 0
    for seed in range(3):
        velocity = make_swarm(seed, followers=25)
        targets, _, lone, classes, _ = compare(velocity, heads=[0])
        alone = own_evidence(targets, lone.single, classes[0])[lone.single.uav == 0]
        assert np.median(alone) < np.log(len(velocity))
        found = fit(velocity)
        heads += found.extras["heads"].tolist() == [0]
    assert heads == 3


@pytest.mark.parametrize(("uavs", "longest"), [(5, 2), (5, 9), (12, 9)])
def test_the_log_odds_of_a_delay_pay_for_every_law_and_leader_that_was_tried(uavs, longest):
    """Three classes of features, and one law for each delay beyond the memory; each of the other UAVs may lead."""
    velocity = make_swarm(1, followers=2, copied=0.6, others=uavs - 3)
    odds, evidence = compare_delays(velocity, lagged(velocity, LAGS), longest)
    laws = 3 + longest - LAGS
    price = np.log(1.0 / RARE - 1.0) + np.log((uavs - 1) * laws)
    apart = ~np.eye(uavs, dtype=bool)
    np.testing.assert_allclose(odds[apart], (evidence - np.maximum(evidence.T, 0.0) - price)[apart], atol=1e-6)
    assert np.isneginf(np.diag(odds)).all()
