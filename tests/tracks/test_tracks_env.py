"""``USNET/Tracks-v0``: recorded tracks window by window, scored by the file's leaders."""

from pathlib import Path

import gymnasium as gym
import numpy as np
import pandas as pd
import pytest
from gymnasium.utils.env_checker import check_env
from track_files import example, write_csv

from usnet_env import ArgumentError, Window, evaluate, make_detector
from usnet_env.replay import record_episode
from usnet_env.replay.story import describe_outcome
from usnet_env.tracks import read_tracks


def write_merging(folder, columns):
    header = ["id", "t", "x", "y", "leader"][:columns]
    return str(write_csv(folder / "merging.csv", [row[:columns] for row in example().merging()], header))


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return write_merging(tmp_path_factory.mktemp("tracks"), 5)


def make(file, **arguments):
    return gym.make("USNET/Tracks-v0", **{"path": file, "step": 0.5, **arguments})


def test_gymnasiums_checker_has_nothing_to_say_a_path_object_is_taken_and_no_path_is_refused(path):
    check_env(make(path).unwrapped, skip_render_check=True)
    assert make(Path(path)).unwrapped.config.path == path
    with pytest.raises(ArgumentError, match=r"^path must"):
        gym.make("USNET/Tracks-v0")


def test_windows_follow_in_the_order_of_time_and_nothing_is_destroyed(path):
    env, cuts = make(path), list(read_tracks(path).resample(0.5).windows(100))
    for cut in [*cuts, cuts[0]]:
        observation, info = env.reset()
        assert (info["start"], info["end"]) == (cut.start, cut.end)
        assert env.observation_space.contains(observation)
        window = Window.from_observation(observation)
        assert window.step == 0.5
        np.testing.assert_array_equal(window.velocity, cut.window.velocity)
        after, reward, terminated, truncated, info = env.step(np.ones(14, np.int8))
        assert (terminated, truncated, info["round"]) == (True, False, 1)
        np.testing.assert_array_equal(after["alive"], observation["alive"])
        assert reward == -info["J"] == -(1 + info["redundant"] / 14)
        with pytest.raises(ArgumentError, match=r"^reset must be called first"):
            env.step(np.ones(14, np.int8))


def test_the_truth_is_the_column_of_leaders(path):
    env = make(path)
    heads = []
    for _ in range(7):
        env.reset()
        truth = env.unwrapped.swarm
        heads.append(np.flatnonzero(truth.head).tolist())
        assert set(truth.root) == set(heads[-1])  # of the head, not of the direct leader
    assert heads == [[0, 1]] * 4 + [[0]] * 3


def test_a_seed_draws_a_window(path):
    env = make(path)
    starts, again = ([env.reset(seed=seed)[1]["start"] for seed in range(20)] for _ in range(2))
    assert starts == again
    assert len(set(starts)) > 4
    batch = gym.make_vec("USNET/Tracks-v0", 20, path=path, step=0.5, autoreset_mode="SameStep")
    assert batch.reset(seed=0)[1]["start"].tolist() == starts
    assert batch.step(np.zeros((20, 14), np.int8))[2].all()
    assert batch.metadata["autoreset_mode"].value == "SameStep"


def test_tracks_without_leaders_can_be_played_but_not_scored(tmp_path):
    env = make(plain := write_merging(tmp_path, 4))
    env.reset()
    assert env.step(np.zeros(14, np.int8))[2]
    with pytest.raises(ArgumentError, match="leader"):
        evaluate("USNET/Tracks-v0", "none", episodes=1, env_kwargs={"path": plain})


def test_a_record_of_tracks_without_leaders_holds_what_was_found(path, tmp_path):
    detector, plain = make_detector("directional-delays"), write_merging(tmp_path, 4)
    known = record_episode(make(path), detector, 0, 0)
    found = record_episode(make(plain), detector, 0, 0)
    answer = detector.detect(Window.from_observation(make(plain).reset(seed=0)[0]))
    assert known.labelled
    assert known.objective > 0
    assert not found.labelled
    np.testing.assert_array_equal(found.head, answer.candidates)
    np.testing.assert_array_equal(np.unique(found.root[0]), np.flatnonzero(answer.candidates))
    assert [int(each.sum()) for each in (found.decoys, found.fired, found.objective)] == [0, 0, 0]
    assert "the truth is unknown" in describe_outcome(found)
    np.testing.assert_array_equal(found.root, known.root)  # of these tracks the detector finds all leaders


def play(file, detectors, episodes, **options):
    settings = {"path": str(file), "step": 0.5}
    result = evaluate("USNET/Tracks-v0", detectors, episodes=episodes, env_kwargs=settings, **options)
    return pd.DataFrame(result.rows)


def test_evaluate_scores_detectors_with_the_same_metrics_and_known_groups(path):
    rows = play(path, ["directional-delays", "none"], 6)
    means = rows.groupby("detector")[["J", "recall_first", "group_leader_first"]].mean()
    assert means.J["none"] <= means.J["directional-delays"]  # one round: J does not count missed heads
    assert means.recall_first["directional-delays"] >= 0.9
    assert means.group_leader_first["directional-delays"] >= 0.9
    assert means.group_leader_first["none"] < 0.2


def test_windows_without_leaders_have_no_score_of_groups(path, tmp_path):
    head, *rows = Path(path).read_text(encoding="utf-8").splitlines()
    late = max(float(row.split(",")[1]) for row in rows) / 2
    rows = [row if float(row.split(",")[1]) > late else row.rpartition(",")[0] + "," for row in rows]
    (tmp_path / "late.csv").write_text("\n".join([head, *rows]))
    scores = play(tmp_path / "late.csv", "none", 6).group_leader_first
    assert 0 < scores.isna().sum() < 6


@pytest.mark.parametrize(
    ("arguments", "start"),
    [
        ({"path": "nowhere.csv"}, "nowhere.csv: no such file"),
        ({"window": 10**5}, "length must"),
        ({"step": 0}, "step must"),
        ({"path": 3}, "path must"),
    ],
)
def test_a_bad_argument_is_named(path, arguments, start):
    with pytest.raises(ArgumentError, match=f"^{start}"):
        make(path, **arguments)
