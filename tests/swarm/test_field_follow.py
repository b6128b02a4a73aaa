"""Field models: each by its behaviour, against a slow reading of its equation, and a batch against single swarms."""

from dataclasses import replace

import numpy as np
import pytest
from flights import flown, fly, unit

from usnet_env.envs import MultiClusterEnv, SingleClusterEnv
from usnet_env.swarm import FOLLOW_STRATEGIES, SwarmConfig, advance, destroy, start
from usnet_env.swarm.field_follow import Chain, Frontness, Shifted
from usnet_env.swarm.field_kernels import DELAY, GAIN, MIXED, OFFSET, SALT, hash_draw
from usnet_env.swarm.flock_follow import Couzin
from usnet_env.swarm.follow import CONTROLS, FIELD_MODELS

NAMES = sorted(FIELD_MODELS)


def table_of(state):
    return state.parameters.reshape(7, -1)


def members_of(state, i):
    """The living UAVs of the flock of UAV i: the same end of the chain of sources."""

    def top(a):
        follows = ~(state.head | state.decoy)
        while a < len(state.source) and follows[a] and state.source[a] not in (a, -1):
            a = state.source[a]
        return a

    return [j for j in np.flatnonzero(state.alive & ~state.not_led) if top(j) == top(i)]


def best_delay(led, flew, most=20):
    """The delay at which the cosine of two tracks is largest (Nagy et al. 2010)."""
    return max(range(1, most), key=lambda d: (unit(led[most - d : -d]) * unit(flew[most:])).sum(axis=1).mean())


def test_every_model_says_what_it_is_and_where_it_is_from():
    assert set(NAMES) <= set(FOLLOW_STRATEGIES)
    for model in FIELD_MODELS.values():
        assert model.equation
        assert model.citation
        assert model.breaks
        assert model.version >= 1


def links_of(state, i, links):
    """The UAVs above UAV i and the delays to them, as the equation of the models of copying says."""
    above, late, a, delay = [], [], i, 0
    while len(above) < links and not state.head[a]:
        delay += int(table_of(state)[DELAY, a])
        a = state.source[a]
        above.append(a)
        late.append(delay)
    return above, late


@pytest.mark.parametrize("name", ["unequal_delays", "chain", "pigeons", "cucker_smale", "part_time", "partial_turns"])
def test_copies_obey_their_equation(name):
    model = replace(FIELD_MODELS[name], noise=0.0, idle_noise=0.0, noises=(1, 1))
    model = model if name != "unequal_delays" else replace(model, noise=1e-9)
    state, window = fly(model, formation="around")
    v, p = flown(window)
    gain, salt = table_of(state)[GAIN], table_of(state)[SALT]
    for i in np.flatnonzero(~state.head)[::3]:
        above, late = links_of(state, i, model.links)
        for t in range(max(late), 90):
            clock = int(state.clock) + 12 + t
            asked = {"part_time": state.root[i], "partial_turns": i}.get(name)
            if asked is not None and hash_draw(salt[asked], clock // model.block_steps) >= model.response_probability:
                wanted = v[t - 1, i]
            elif name == "cucker_smale":
                late = [1] * len(above)
                near = [(np.linalg.norm(p[t, a] - p[t, i]) / model.scale) ** 2 for a in above]
                weight = [model.strength / len(near) / (1 + square) ** 0.4 for square in near]
                wanted = v[t - 1, i] + sum(w * (v[t - 1, a] - v[t - 1, i]) for w, a in zip(weight, above, strict=True))
            else:
                copied = np.mean([v[t - d, a] for d, a in zip(late, above, strict=True)], axis=0)
                wanted = (1 - gain[i]) * v[t - 1, i] + gain[i] * copied
            if t:
                np.testing.assert_allclose(v[t, i], unit(wanted), atol=2e-3)


def depth_of(state, i):
    return 0 if state.head[i] else 1 + depth_of(state, state.source[i])


@pytest.mark.parametrize("depth", [1, 2, 3])
def test_a_chain_of_command_has_its_depth(depth):
    state, window = fly(Chain(depth=depth), uavs=40, observation_steps=200)
    v, _ = flown(window)
    depths = [depth_of(state, i) for i in range(40)]
    assert max(depths) == depth
    for i in range(40):
        a = i
        while not state.head[a]:
            a = state.source[a]
        assert a == state.root[i]
        if depths[i]:
            assert best_delay(v[:, state.root[i]], v[:, i]) == depths[i]
    np.testing.assert_array_equal(state.leader, state.source)


@pytest.mark.parametrize("name", ["mixed", "switching"])
def test_followers_fly_by_f1_to_f6(name):
    model = replace(FIELD_MODELS[name], noise=0.0)
    state, window = fly(model, observation_steps=120)
    v, p = flown(window)
    salt, kinds = table_of(state)[SALT], set()
    for i in np.flatnonzero(~state.head)[::2]:
        h = state.root[i]
        for t in range(4, 119):
            block = (int(state.clock) + 12 + t) // model.block_steps
            kind = int(MIXED * hash_draw(salt[i], 0) if name == "mixed" else MIXED * hash_draw(salt[h], block))
            kinds.add(kind)
            past = v[t - 3 : t, h][::-1]
            gap = p[t - 1, h] - p[t - 1, i]
            wanted = [
                past[0],
                past[:2].sum(axis=0),
                past.sum(axis=0),
                (past[:2] ** 2).sum(axis=0),
                (past**2).sum(axis=0),
                past[0] + (np.linalg.norm(gap) > 60) * unit(gap),
            ][kind]
            np.testing.assert_allclose(v[t, i], unit(wanted), atol=3e-3)
    assert len(kinds) >= 4


def test_formations_obey_their_equation():
    model = Frontness(noise=0.0)
    state, window = fly(model, formation="around", mobility="gauss_markov", rounds=2)
    v, p = flown(window)
    for i in np.flatnonzero(~state.head)[::4]:
        h = state.root[i]
        for t in range(12, 90):
            course = unit(v[t - model.smoothing : t, h].sum(axis=0))
            level = unit(np.array([-course[1], course[0], 0.0]))
            frame = np.stack([course, level, np.cross(course, level)], axis=1)
            gap = p[t, h] + frame @ table_of(state)[OFFSET:, i].astype(float) - p[t, i]
            wanted = v[t - 1, h] + model.pull * gap / max(np.linalg.norm(gap), model.near)
            np.testing.assert_allclose(v[t, i], unit(wanted), atol=5e-3)


@pytest.mark.parametrize("name", ["reference", "shepherd", *CONTROLS])
def test_swarms_that_no_uav_leads_have_no_heads_and_one_round(name):
    env = MultiClusterEnv(follow=name, memory=12, clusters=2, uavs=24, reveal_truth=True, observation_steps=20)
    observation, info = env.reset(seed=0)
    assert not info["head"].any()
    assert (info["root"][~env.swarm.not_led] == -1).all()
    assert (info["leader"][~env.swarm.not_led] == -1).all()
    assert observation["seen"].all()
    candidates = np.zeros(24, np.int8)
    candidates[:2] = 1
    _, reward, terminated, truncated, info = env.step(candidates)
    assert (terminated, truncated, info["hits"], info["redundant"]) == (True, False, 0, 2)
    assert reward == pytest.approx(-(1 + 2 / 24))
    single = SingleClusterEnv(follow=name, memory=12, observation_steps=20)
    for named, expected in ((0, 0.0), (1, -1.0), (3, -3.0)):
        single.reset(seed=0)
        candidates = np.zeros(16, np.int8)
        candidates[:named] = 1
        _, reward, terminated, _, info = single.step(candidates)
        assert terminated
        assert reward == info["J"] == expected


def flock_direction(model, state, v, p, t, i, members):
    """The direction of one UAV, neighbour by neighbour."""
    gap = {j: p[t, j] - p[t, i] for j in members if j != i}
    distance = {j: np.linalg.norm(gap[j]) for j in gap}
    close = [j for j in gap if distance[j] < model.repulsion]
    aligned = [*(j for j in gap if distance[j] < model.alignment), i]
    attracted = [j for j in gap if distance[j] < model.attraction]
    if close:
        wanted = unit(-sum(gap[j] / distance[j] for j in close))
    elif len(aligned) > 1 or attracted:
        wanted = model.align * np.mean([v[t - 1, j] for j in aligned], axis=0)
        wanted = wanted + model.attract * sum(gap[j] / distance[j] for j in attracted) / max(len(attracted), 1)
    else:
        wanted = unit(p[t, members].mean(axis=0) - p[t, i])
    for h in np.flatnonzero(state.not_led):
        away = p[t, i] - p[t, h]
        if np.linalg.norm(away) < model.flight:
            wanted = wanted + model.flee * unit(away)
    return wanted


@pytest.mark.parametrize(("uavs", "clusters"), [(24, 2), (300, 1)])  # in one block of UAVs, and in three
@pytest.mark.parametrize("name", ["vicsek", "couzin", "predator", "shepherd", "repulsion"])
def test_flocks_obey_their_equation(name, uavs, clusters):
    far = Couzin(repulsion=30.0, alignment=10.0, attraction=5.0)  # farther than the others
    model = replace({**FIELD_MODELS, "repulsion": far}[name], noise=0.0)
    flight = {"formation": "around", "mobility": "gauss_markov", "observation_steps": 25}
    state, window = fly(model, uavs=uavs, clusters=clusters, **flight)
    v, p = flown(window)
    for i in np.flatnonzero(~(state.head | state.not_led))[:: uavs // 12]:
        members = members_of(state, i)
        for t in range(1, 25, 4):
            wanted = unit(flock_direction(model, state, v, p, t, i, members))
            np.testing.assert_allclose(v[t, i], wanted, atol=0.01)


@pytest.mark.parametrize("kinematics", ["unit", "varied_speed"])
def test_shifted_tracks_keep_their_steps_and_are_far_apart_in_time(kinematics):
    """The same seed draws f2's swarm, so each track is a rolled one of f2."""
    settings = {
        "mobility": "gauss_markov", "cluster_sizes": [9, 9], "uavs": 20, "observation_steps": 200,
        "kinematics": kinematics,
    }  # fmt: skip
    state, window = fly("shifted", **settings)
    v, p = flown(window)
    assert not state.head.any()
    assert (state.root == -1).all()

    class Unshifted(Shifted):
        shifts_tracks = False

    _, other = fly(Unshifted(), **settings)
    true, place = flown(other)
    np.testing.assert_array_equal(p[0], place[0])
    shifts = np.array([[np.abs(np.roll(true[:, i], s, axis=0) - v[:, i]).max() for s in range(200)] for i in range(20)])
    np.testing.assert_array_equal(shifts.min(axis=1), 0)
    shift = shifts.argmin(axis=1)
    for head in np.unique(state.source):
        own = np.sort(shift[state.source == head])
        assert len(own) == 10
        assert np.diff(np.append(own, own[0] + 200)).min() >= 19
    np.testing.assert_allclose(np.diff(p, axis=0), v, atol=1e-3)


@pytest.mark.parametrize("name", ["chain", "pigeons", "couzin", "predator"])
@pytest.mark.parametrize("led", ["", "-led"])
def test_after_a_destruction_every_follower_has_a_living_leader(name, led):
    """A visible one, also where heads follow unseen UAVs."""
    follow, led_by = name + led * (name != "pigeons"), (1, 4) if led else 0
    config = SwarmConfig(follow=follow, led_by=led_by, memory=12, clusters=3, uavs=40, decoys=1, bystanders=2)
    rng = np.random.default_rng(0)
    state = start(config, [rng])
    for _ in range(3):
        before = state
        candidates = rng.random((1, 40)) < 0.2
        candidates[0, np.flatnonzero((state.head & state.alive)[0])[-1]] = False
        state = destroy(state, candidates)
        one, old = state.episode(), before.episode()
        alone = np.flatnonzero(one.head | one.decoy)
        np.testing.assert_array_equal(one.root[alone], alone)
        assert one.leader.max() < 40
        for i in np.flatnonzero(one.alive & ~(one.head | one.decoy | one.not_led)):
            assert one.alive[one.source[i]]
            assert one.head[one.root[i]]
            assert one.alive[one.root[i]]
            assert one.root[one.source[i]] == one.root[i]
            if one.alive[old.source[i]]:
                assert one.source[i] == old.source[i]
        state, window = advance(config, state, [rng])
    assert window.position.shape[2] == 40
    state, _ = advance(config, destroy(state, state.head), [rng])
    assert np.isfinite(state.reference_position).all()  # unseen UAVs that no UAV follows fly on


def test_bystanders_and_traffic_are_no_heads_and_follow_no_uav():
    one, window = fly(uavs=40, bystanders=5, traffic=6, head_jitter=True)
    v, _ = flown(window)
    assert one.not_led.sum() == 11
    with pytest.warns(DeprecationWarning, match="bystander is now not_led"):
        assert one.bystander is one.not_led
    assert not (one.not_led & (one.head | one.decoy)).any()
    np.testing.assert_array_equal(one.root[one.not_led], np.flatnonzero(one.not_led))
    assert not np.isin(one.root[~one.not_led], np.flatnonzero(one.not_led)).any()
    straight = np.ptp(v, axis=0).max(axis=1) < 1e-5
    assert straight.sum() == 6
    assert one.not_led[straight].all()
    assert np.abs(v[:, straight, 2]).max() < 1e-6
    courses = {tuple(np.round(np.abs(v[0, i, :2]), 3)) for i in np.flatnonzero(straight)}
    assert len(courses) <= 3  # three corridors, both ways
