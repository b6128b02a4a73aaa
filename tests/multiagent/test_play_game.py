"""Scripted policies, whole games, pictures and records."""

import numpy as np
import pytest
from gymnasium import spaces
from small_games import small

from usnet_env import ArgumentError, Detection, make_detector
from usnet_env.multiagent import usnet_evasion_v0, usnet_observers_v0
from usnet_env.multiagent.play import play_game
from usnet_env.multiagent.policies import CamouflagedHead, DetectorObserver, RandomHead, RandomObserver, TruthfulHead
from usnet_env.replay import EpisodeRecord
from usnet_env.replay.story import tell_round
from usnet_env.swarm.follow import LaggedSum

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
@pytest.mark.parametrize("observer", ["random", "lagged-regression", "destroy-all"])
def test_every_detector_votes(fusion, observer):
    env = small("observers", fusion=fusion, max_rounds=3)
    game = play_game(env, {"observer": DetectorObserver(make_detector(observer))}, 0)
    assert len(set(game.returns.values())) == 1
    assert game.returns["observer_2"] == pytest.approx(-game.J)
    assert pytest.approx(game.rounds + game.redundant / 20) == game.J


def test_lagged_regression_solves_the_truthful_swarm_and_delayed_followers_evade_it():
    env = usnet_evasion_v0.parallel_env()
    detector = DetectorObserver(make_detector("lagged-regression"))
    late = CamouflagedHead(mobility=0, decoys=0)
    assert play_game(env, {"observer": detector, "head": TruthfulHead()}, 0).J == 1.0
    assert play_game(env, {"observer": detector, "head": late}, 0).J > 3
    longer = DetectorObserver(make_detector("lagged-regression(lags=8)"))
    assert play_game(env, {"observer": longer, "head": late}, 0).J == 1.0


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


def test_the_error_names_the_agent_without_a_policy():
    env = small("evasion")
    with pytest.raises(ArgumentError, match=r"policies must .* for head_0 or its role head"):
        play_game(env, {"observer": RandomObserver()}, 0)
    with pytest.raises(ArgumentError, match=r"policies must .* for head_0 .*detectors for observers only"):
        play_game(env, dict.fromkeys(("observer", "head"), DetectorObserver(make_detector("random"))), 0)
    with pytest.raises(ArgumentError, match="seed must"):
        play_game(env, {"observer": RandomObserver(), "head": TruthfulHead()}, -1)
    with pytest.raises(ArgumentError, match="detector must"):
        DetectorObserver(3)


@pytest.mark.parametrize("game", ["observers", "evasion"])
def test_a_game_is_kept(game, tmp_path):
    env = small(game, max_rounds=3, follow=LaggedSum(1))
    played = play_game(env, {"observer": RandomObserver(2), "head": CamouflagedHead()}, 1, label="random pair")
    record = EpisodeRecord(**played.record)
    assert (record.rounds, record.redundant.sum()) == (played.rounds, played.redundant)
    assert record.objective[-1] == played.J
    assert (record.env_id, record.detector) == (f"usnet_{game}_v0", "random pair")
    assert record.config["follow"].startswith("LaggedSum(")
    loaded = EpisodeRecord.load(record.save(tmp_path / "episode.npz"))
    assert (loaded.rounds, loaded.choices) == (record.rounds, record.choices)
    assert (loaded.observers is not None) == (game == "observers")
    names = list(map(str, range(20)))
    words = " ".join(text for k in range(record.rounds) for text in tell_round(loaded, k + 1, names))
    assert ("followers delayed by 4 steps; price" in words) == (game == "evasion")
    assert ("What the heads chose" in words) == (game == "evasion")


def test_decoys_of_a_window_have_no_head_in_the_record():
    env = small("evasion", max_rounds=2)
    drawn_game = play_game(env, {"observer": RandomObserver(), "head": RandomHead()}, 1)
    assert drawn_game.record["detector"] == "RandomObserver"
    policies = {"observer": DetectorObserver(make_detector("none")), "head": CamouflagedHead()}
    record = EpisodeRecord(**play_game(env, policies, 1).record)
    assert record.detector == "none"
    alone = (record.root == np.arange(20)) & ~record.head
    assert (alone.sum(axis=1) >= 3).all()
    assert not record.decoy.any()
    truth = env.games.reveal().episode()  # the last window's
    np.testing.assert_array_equal(truth.decoy, (truth.root == np.arange(20)) & ~truth.head)
    assert truth.decoy.sum() >= 3
    plain = EpisodeRecord(**play_game(env, {**policies, "head": TruthfulHead()}, 1).record)
    assert not ((plain.root == np.arange(20)) & ~plain.head).any()
