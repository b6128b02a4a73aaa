"""Minari keeps detectors' games as they were, and a network learns from them."""

import gymnasium as gym
import numpy as np
import pytest

pytest.importorskip("minari")
pytest.importorskip("torch")

import minari
import minari_imitation as example
import torch
from comparison import compare_detectors

from detectors.policy_detector import PolicyDetector
from usnet_env import make_detector

GAMES = 30


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MINARI_DATASETS_PATH", str(tmp_path_factory.mktemp("datasets")))
        yield


@pytest.fixture(scope="module")
def dataset(folder):
    example.record(GAMES, seed=100)
    return minari.load_dataset(example.DATASET)


def test_what_is_read_back_is_what_was_played(dataset):
    assert dataset.total_episodes == GAMES
    assert dataset.storage.metadata["algorithm_name"] == example.TEACHER
    env = gym.make(example.ENV, **example.ARGUMENTS)
    for game in dataset.sample_episodes(5):
        seed = next(iter(dataset.storage.get_episode_metadata([game.id])))["seed"]
        observation, info = env.reset(seed=int(seed))
        for step, action in enumerate(game.actions):
            for name, kept in game.observations.items():
                np.testing.assert_array_equal(kept[step], observation[name])
                assert kept.dtype == observation[name].dtype
            observation, reward, terminated, truncated, info = env.step(action)
            assert (game.rewards[step], game.terminations[step], game.truncations[step]) == (
                reward,
                terminated,
                truncated,
            )
            assert game.infos["J"][step + 1] == info["J"]
        assert terminated or truncated


def test_the_environment_comes_with_the_data(dataset):
    env = dataset.recover_environment()
    assert env.unwrapped.config == gym.make(example.ENV, **example.ARGUMENTS).unwrapped.config


def test_a_game_of_several_rounds_gives_a_pair_a_round():
    env = gym.make(example.ENV, **{**example.ARGUMENTS, "clusters": 3})
    game = example.play_episode(env, make_detector("one-per-round"), 0, seed=4)
    velocity, alive, named = example.load_rounds([game, game])
    rounds = len(game.rewards)
    assert rounds > 1
    assert velocity.shape == (2 * rounds, 20, 12, 3)
    assert alive.sum(dim=1).tolist() == 2 * list(range(12, 12 - rounds, -1))
    assert named.sum(dim=1).tolist() == 2 * rounds * [1]
    assert (named <= alive).all()


def test_the_student_learns(dataset):
    student, losses = example.imitate(dataset, updates=60)
    assert np.isfinite(losses).all()
    assert losses[-1] < 0.2 * losses[0]
    torch.manual_seed(0)
    pairs = zip(student.parameters(), example.Student().parameters(), strict=True)
    assert all(bool((after != before).any()) for after, before in pairs)
    detectors = {"student": PolicyDetector(student), "random": "random(count=2)"}
    scores = compare_detectors(example.ENV, example.ARGUMENTS, detectors, episodes=30)
    assert scores["student"]["f1_first"]["mean"] > 0.8 > scores["random"]["f1_first"]["mean"]


def test_the_script_keeps_the_data_where_it_is_told(capsys, tmp_path, monkeypatch):
    monkeypatch.setenv("MINARI_DATASETS_PATH", "")  # put back afterwards
    example.main(["--games", "3", "--updates", "2", "--episodes", "2", "--datasets", str(tmp_path)])
    assert (tmp_path / example.DATASET).is_dir()
    assert capsys.readouterr().out.startswith("3 games, ")
