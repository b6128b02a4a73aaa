"""Scripted policies, whole games, pictures and records, and the wrapper for discrete actions."""

import numpy as np
import pytest
from gymnasium import spaces
from small_games import SMALL, drawn, small

from usnet_env import ArgumentError, Detection, make_detector
from usnet_env.evaluation import evaluate_games
from usnet_env.multiagent import usnet_evasion_v0, usnet_observers_v0
from usnet_env.multiagent.play import play_game
from usnet_env.multiagent.policies import (
    CamouflagedHead,
    DetectorObserver,
    RandomHead,
    RandomObserver,
    TruthfulHead,
)
from usnet_env.multiagent.wrappers import DiscreteActions
from usnet_env.replay import EpisodeRecord, write_recording
from usnet_env.replay.figure import write_picture
from usnet_env.swarm.follow import Lags

HEADS = {"truthful": TruthfulHead(), "camouflaged": CamouflagedHead(), "random": RandomHead()}


class Noting:
    """A detector that names the first living UAV and keeps its windows and seeds."""

    def __init__(self):
        self.windows, self.seeds = [], []

    def reset(self, seed=None):
        self.seeds.append(seed)

    def detect(self, window):
        self.windows.append(window)
        first = np.arange(window.uavs) == np.flatnonzero(window.alive)[0]
        return Detection(candidates=first, scores=np.linspace(0.1, 0.9, window.uavs))


# --- policies --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("heads", list(HEADS))
@pytest.mark.parametrize("observer", ["random", "lagged-regression"])
def test_every_pair_of_policies_plays_evasion(heads, observer):
    env = small("evasion", max_rounds=4)
    policy = RandomObserver() if observer == "random" else DetectorObserver(make_detector(observer))
    games = [play_game(env, {"observer": policy, "head": HEADS[heads]}, seed) for seed in (2, 2, 3)]
    assert games[0].returns == games[1].returns
    flights = [game.record["position"][0] for game in games]
    np.testing.assert_array_equal(flights[0], flights[1])
    assert not np.array_equal(flights[0], flights[2])
    assert games[0].returns["observer_0"] == pytest.approx(-games[0].J)
    assert (games[0].prices["head_0"] > 0) == (heads != "truthful")
    assert games[0].rounds <= 4
    EpisodeRecord(**games[0].record)


@pytest.mark.parametrize("fusion", ["union", "majority", "scores"])
@pytest.mark.parametrize("observer", ["random", "lagged-regression", "lagged-correlation", "destroy-all", "none"])
def test_every_detector_votes(fusion, observer):
    env = small("observers", fusion=fusion, max_rounds=3)
    game = play_game(env, {"observer": DetectorObserver(make_detector(observer))}, 0)
    assert len(set(game.returns.values())) == 1
    assert game.returns["observer_2"] == pytest.approx(-game.J)
    assert pytest.approx(game.rounds + game.redundant / 20) == game.J


def test_lagged_regression_solves_the_truthful_swarm_and_delayed_followers_evade_it():
    """The main result of the pay-off table, on three seeds."""
    env = usnet_evasion_v0.parallel_env()
    detector = DetectorObserver(make_detector("lagged-regression"))
    late = CamouflagedHead(mobility=0, decoys=0)
    truthful, hidden, countered = (
        [play_game(env, {"observer": observer, "head": heads}, seed).J for seed in range(3)]
        for observer, heads in (
            (detector, TruthfulHead()),
            (detector, late),
            (DetectorObserver(make_detector("lagged-regression(lags=8)")), late),
        )
    )
    assert truthful == [1.0] * 3
    assert countered == [1.0] * 3
    assert np.mean(hidden) > 5


def test_a_camouflaged_head_chooses_the_largest_legal_values():
    env = small("evasion")
    observations, _ = env.reset(seed=0)
    observations, *_ = env.step(drawn(env, np.random.default_rng(0), observations))
    for policy, expected in (
        (CamouflagedHead(), [2, 0, 2, 4]),
        (CamouflagedHead(mobility=1, jitter=True, decoys=1, delay=0), [1, 1, 1, 0]),
        (TruthfulHead(), [0, 0, 0, 0]),
    ):
        policy.reset(0, env.action_space("head_0"))
        assert policy.act(observations["head_0"]).tolist() == expected
    alone = {**observations["head_0"], "legal": np.array([1] * 5 + [1, 0, 0] + [1] * 5)}
    policy = CamouflagedHead()
    policy.reset(0, env.action_space("head_0"))
    assert policy.act(alone).tolist() == [2, 0, 0, 4]
    lucky = RandomHead()
    lucky.reset(0, env.action_space("head_0"))
    choices = np.array([lucky.act(alone) for _ in range(200)])
    assert choices.max(axis=0).tolist() == [2, 1, 0, 4]
    assert choices.min(axis=0).tolist() == [0, 0, 0, 0]


def test_a_detector_sees_what_its_observer_saw_and_nothing_else():
    env = small("observers", message_size=0)
    observations, _ = env.reset(seed=0)
    policy = DetectorObserver(Noting())
    policy.reset(0, env.action_space("observer_0"))
    vote = policy.act(observations["observer_0"])
    (window,) = policy.detector.windows
    legal = observations["observer_0"]["legal"].astype(bool)
    assert 0 < legal.sum() < 20
    np.testing.assert_array_equal(window.alive, legal)
    np.testing.assert_array_equal(window.seen, observations["observer_0"]["seen"])
    assert np.flatnonzero(vote).tolist() == [np.flatnonzero(legal)[0]]
    unseen = {**observations["observer_0"], "legal": np.zeros(20, np.int8)}
    assert not policy.act(unseen).any()
    assert len(policy.detector.windows) == 1


def test_scores_for_a_vote():
    space = spaces.Box(0, 1, (4,), np.float32)
    env = usnet_observers_v0.parallel_env(clusters=1, uavs=4, observers=1, sensing_range=1e5, observation_steps=12)
    observation = env.reset(seed=0)[0]["observer_0"]

    def vote(**answer):
        class Fixed(Noting):
            def detect(self, window):
                return Detection(**answer)

        policy = DetectorObserver(Fixed())
        policy.reset(0, space)
        return policy.act(observation)

    candidates, scores = [True, True, False, False], [4.0, 2.0, 1.0, 0.0]
    np.testing.assert_allclose(vote(candidates=candidates, scores=scores), [1, 1, 0.5, 0])
    np.testing.assert_allclose(vote(candidates=candidates, scores=[0.0, 2.0, 1.0, -1.0]), [1, 1, 0, 0])
    sure = {"probability": np.array([0.9, 0.3, 0.2, 0.0])}
    np.testing.assert_allclose(vote(candidates=candidates, scores=scores, extras=sure), [0.9, 0.3, 0.2, 0], rtol=1e-6)
    none = vote(candidates=candidates, scores=scores, extras={"probability": None})
    np.testing.assert_array_equal(none, vote(candidates=candidates, scores=scores))
    assert not vote(candidates=[False] * 4, scores=scores).any()


def test_each_agent_has_its_own_copy_of_the_policy_and_its_own_seed():
    seen = []

    class Kept(RandomObserver):
        def reset(self, seed, action_space):
            seen.append((id(self), seed))
            super().reset(seed, action_space)

    env = small("observers", max_rounds=2)
    play_game(env, {"observer": Kept()}, 0)
    assert len({one for one, _ in seen}) == len({seed for _, seed in seen}) == 3
    assert 0 not in {seed for _, seed in seen}


def test_a_policy_of_one_agent_is_not_copied():
    class Uncopied(RandomObserver):
        def __deepcopy__(self, memory):
            raise TypeError("cannot pickle '_thread.lock' object")

    played = play_game(small("evasion", max_rounds=2), {"observer": Uncopied(), "head": TruthfulHead()}, 0)
    again = play_game(small("evasion", max_rounds=2), {"observer": RandomObserver(), "head": TruthfulHead()}, 0)
    assert played.returns == again.returns


def test_the_error_names_the_agent_without_a_policy():
    env = small("evasion")
    with pytest.raises(
        ArgumentError, match=r"policies must hold a policy for head_0 or its role head, got \['observer'\]"
    ):
        play_game(env, {"observer": RandomObserver()}, 0)
    with pytest.raises(ArgumentError, match="env must be the parallel_env of a usnet_env game"):
        play_game(small("evasion", "env"), {}, 0)
    with pytest.raises(ArgumentError, match="detector must have the methods reset and detect"):
        DetectorObserver(3)
    with pytest.raises(ArgumentError, match="action_space must be MultiDiscrete for a head"):
        play_game(env, {"observer": RandomObserver(), "head": TruthfulHead(), "observer_0": TruthfulHead()}, 0)
    with pytest.raises(ArgumentError, match="action_space must be MultiBinary or Box for an observer"):
        play_game(env, {"observer": RandomObserver(), "head": RandomObserver()}, 0)


# --- pictures and records --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("game", ["observers", "evasion"])
def test_a_game_is_kept_replayed_and_drawn(game, tmp_path):
    pytest.importorskip("rerun")
    pytest.importorskip("matplotlib")
    env = small(game, max_rounds=3)
    played = play_game(env, {"observer": RandomObserver(2), "head": CamouflagedHead()}, 1, label="random pair")
    record = EpisodeRecord(**played.record)
    assert record.rounds == played.rounds
    assert record.redundant.sum() == played.redundant
    assert record.objective[-1] == played.J
    assert (record.env_id, record.detector) == (f"usnet_{game}_v0", "random pair")
    assert EpisodeRecord.load(record.save(tmp_path / "episode.npz")).rounds == record.rounds
    assert write_recording(record, tmp_path / "replay.rrd").stat().st_size > 0
    assert write_picture(record, tmp_path / "episode.png").stat().st_size > 0


def test_a_strategy_that_is_an_object_is_kept_as_text():
    env = small("observers", max_rounds=1, follow=Lags(1))
    record = EpisodeRecord(**play_game(env, {"observer": RandomObserver()}, 1).record)
    assert record.config["follow"].startswith("Lags(")


def test_decoys_of_a_window_have_no_head_in_the_record():
    env = small("evasion", max_rounds=2)
    assert (
        play_game(env, {"observer": RandomObserver(), "head": RandomHead()}, 1).record["detector"] == "RandomObserver"
    )
    policies = {"observer": DetectorObserver(make_detector("none")), "head": CamouflagedHead()}
    record = EpisodeRecord(**play_game(env, policies, 1).record)
    assert record.detector == "none"
    alone = (record.root == np.arange(20)) & ~record.head
    assert (alone.sum(axis=1) >= 3).all()
    assert not record.decoy.any()
    table = env.state()[:-1].reshape(20, 10)  # the last window's
    np.testing.assert_array_equal(table[:, 8] == 1, (table[:, 9] == np.arange(20)) & (table[:, 7] == 0))
    assert table[:, 8].sum() >= 3
    plain = EpisodeRecord(**play_game(env, {**policies, "head": TruthfulHead()}, 1).record)
    assert not ((plain.root == np.arange(20)) & ~plain.head).any()


@pytest.mark.parametrize("game", ["observers", "evasion"])
def test_frames_show_the_last_round(game):
    pytest.importorskip("matplotlib")
    env = small(game, render_mode="rgb_array", max_rounds=3)
    env.reset(seed=0)
    first = env.render()
    env.step(drawn(env, np.random.default_rng(0), None, share=0.0))
    env.step(drawn(env, np.random.default_rng(1), None, share=0.2))
    after = env.render()
    assert first.dtype == np.uint8
    assert first.shape == after.shape
    assert (first != after).any()
    assert small(game).render() is None


# --- discrete actions -----------------------------------------------------------------------------------------------


def test_discrete_actions_are_the_games_own():
    inner = small("evasion")
    env, twin = DiscreteActions(small("evasion")), small("evasion")
    assert env.action_space("observer_0") == spaces.Discrete(21)
    assert env.action_space("head_1") == spaces.Discrete(3 * 2 * 3 * 5)
    env.reset(seed=0)
    twin.reset(seed=0)
    rng = np.random.default_rng(0)
    while env.agents:
        numbers, actions = {}, {}
        for agent in env.agents:
            number = int(rng.integers(env.action_space(agent).n))
            numbers[agent] = number
            if agent == "observer_0":
                actions[agent] = (np.arange(20) == number).astype(np.int8)
            else:
                actions[agent] = np.array(np.unravel_index(number, inner.action_space(agent).nvec))
        got, expected = env.step(numbers), twin.step(actions)
        assert got[1:] == expected[1:]
        for agent, seen in got[0].items():
            assert env.observation_space(agent).contains(seen)
            np.testing.assert_array_equal(seen["legal"], expected[0][agent]["legal"])


def test_the_action_mask_says_what_is_legal():
    env = DiscreteActions(usnet_evasion_v0.parallel_env(**SMALL, cluster_sizes=(2, 2, 13)))
    observations, _ = env.reset(seed=0)
    assert np.flatnonzero(observations["observer_0"]["action_mask"]).tolist() == [
        20
    ]  # only "no UAV" is legal in the opening
    assert {int(observations[f"head_{j}"]["action_mask"].sum()) for j in range(3)} == {3 * 2 * 2 * 5, 3 * 2 * 3 * 5}
    for j in range(3):
        seen = observations[f"head_{j}"]
        masks = np.split(seen["legal"], np.cumsum([3, 2, 3]))
        for number, allowed in enumerate(seen["action_mask"]):
            choice = np.unravel_index(number, (3, 2, 3, 5))
            assert allowed == all(mask[value] for mask, value in zip(masks, choice, strict=True))
    env = DiscreteActions(small("observers"))
    observations, _ = env.reset(seed=0)
    seen = observations["observer_1"]
    np.testing.assert_array_equal(seen["action_mask"], [*seen["legal"], 1])
    assert env.action_space("observer_1").sample(seen["action_mask"]) in np.flatnonzero(seen["action_mask"])


@pytest.mark.parametrize("action", [21, -1, 0.5, None, "a", [1, 2]])
def test_a_number_out_of_range_is_refused(action):
    env = DiscreteActions(small("evasion"))
    env.reset(seed=0)
    with pytest.raises(ArgumentError, match="action of observer_0 must be a whole number from 0 to 20, got"):
        env.step({**dict.fromkeys(env.agents, 0), "observer_0": action})


def test_actions_that_cannot_be_numbered_are_refused():
    with pytest.raises(ArgumentError, match="env must have votes that are candidates"):
        DiscreteActions(small("observers", fusion="scores"))
    with pytest.raises(ArgumentError, match="env must be the parallel_env"):
        DiscreteActions(small("evasion", "env"))
    with pytest.raises(ArgumentError, match="env must have at most 100000 actions"):
        DiscreteActions(small("evasion", most_decoys=1000, most_delay=100, memory=101))
    env = DiscreteActions(small("evasion"))
    env.reset(seed=0)
    with pytest.raises(ArgumentError, match="actions must map agents to actions"):
        env.step(None)


def test_a_detector_is_refused_for_an_agent_without_windows():
    with pytest.raises(ArgumentError, match=r"^policies must hold no detector for head_0, .*, got .*random.*\.$"):
        evaluate_games("usnet_evasion_v0", {"a": {"observer": "random", "head": "random"}}, episodes=1)
