"""Open laws: what a seed draws, and how followers fly by it."""

from dataclasses import replace
from hashlib import sha256
from itertools import product

import numpy as np
import pytest
from flights import fly

from usnet_env.evaluation import load_suite
from usnet_env.swarm.open_follow import ANSWERS, BENT, HEARD, MEMORY, PUBLIC_SEED, OpenLaw, draw_laws
from usnet_env.swarm.strategy import FollowInputs

PLAIN = OpenLaw("late", "copies", "nothing", 3, 0, 0.7, 40.0, 0.5, 1.0, noise=0.0)


def test_a_seed_draws_ten_laws_of_different_parts():
    assert draw_laws(5) == draw_laws(5) != draw_laws(6)
    for seed in range(50):
        laws = draw_laws(seed).values()
        parts = {(law.hears, law.answers, law.bends) for law in laws}
        assert len(parts) == len(laws) == 10
        assert ("late", "copies", "nothing") not in parts


def test_the_suite_has_all_laws_and_the_hash_of_another_seed():
    suite = load_suite("open")
    assert [cell.arguments["follow"] for cell in suite.cells.values()] == list(draw_laws(PUBLIC_SEED))
    assert suite.commitment not in {None, sha256(str(PUBLIC_SEED).encode()).hexdigest()}


@pytest.mark.parametrize("bends", ["nothing", "aside"])
def test_flight_obeys_a_literal_reading(bends):
    state, window = fly(replace(PLAIN, bends=bends, sharpness=1.0), memory=12, mobility="gauss_markov")
    velocity, checked = window.velocity[0].astype(float), 0
    turn = np.pi / 3 if bends == "aside" else 0.0
    turned = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    for i in np.flatnonzero(~state.head):
        for t in range(5, len(velocity) - 1):
            wanted = 0.3 * velocity[t, i] + 0.7 * turned @ velocity[t - 3, state.root[i]]
            np.testing.assert_allclose(velocity[t + 1, i], wanted / np.linalg.norm(wanted), atol=1e-4)
            checked += 1
    assert checked > 100


def make_inputs(uavs=30):
    rng = np.random.default_rng(3)
    head = np.cumsum(rng.normal(0, 0.3, (uavs, MEMORY, 3)), axis=1) + rng.normal(size=(uavs, 1, 3))
    head /= np.linalg.norm(head, axis=2, keepdims=True)
    place = rng.uniform(-60, 60, (uavs, 1, 3)) - np.cumsum(
        np.concatenate([np.zeros((uavs, 1, 3)), head], axis=1), axis=1
    )
    own = rng.uniform(-60, 60, (uavs, 1, 3)) + rng.normal(0, 0.6, (uavs, MEMORY + 1, 3))
    return FollowInputs(own, head, place, rng.random(uavs, dtype=np.float32))


@pytest.mark.parametrize("parts", [*product(HEARD, ANSWERS, BENT)], ids=" ".join)
def test_a_follower_depends_on_its_own_row_and_on_the_head(parts):
    inputs, law = make_inputs(), OpenLaw(*parts, 2, 3, 0.7, 30.0, 0.3, 1.0, noise=0.0)
    direction, rows = law.direction(inputs), np.arange(30)
    assert np.isfinite(direction).all()
    for name in ("own_position", "head_velocity"):
        changed = getattr(inputs, name).copy()
        changed[7:12] = changed[7:12, ::-1]
        after = (law.direction(replace(inputs, **{name: changed})) != direction).any(axis=1)
        assert after[7:12].any()
        assert not after[(rows < 7) | (rows >= 12)].any()


def test_what_is_heard_is_an_average_of_the_past():
    share, distance = np.linspace(0, 1, 9, dtype=np.float32), np.linspace(0, 300, 9)
    for hear in HEARD.values():
        weights = hear(replace(PLAIN, delay=5, spread=3), share, distance)
        np.testing.assert_allclose(weights.sum(axis=1), 1.0)
        assert (weights[:, MEMORY - 3 :] == 0).all()  # the velocity 3 steps before is known too
        age = weights @ np.arange(MEMORY)
        assert (np.diff(age) >= 0).all()
        assert age[0] < age[-1]
