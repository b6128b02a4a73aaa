"""``USNET/Tracks-v0``: recorded tracks window by window, scored by the file's leaders."""

import csv
import re
import sys
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from track_files import example

from usnet_env import ArgumentError, Window, evaluate, make_detector
from usnet_env.evaluation import EvaluationResult
from usnet_env.replay import EpisodeRecord, RecordReplay, record_episode, write_comparison
from usnet_env.replay.story import describe_outcome
from usnet_env.tracks import read_tracks


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    place = tmp_path_factory.mktemp("tracks") / "merging.csv"
    with open(place, "w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([["id", "t", "x", "y", "leader"], *example().merging()])
    return str(place)


def make(file, **arguments):
    return gym.make("USNET/Tracks-v0", **{"path": file, "step": 0.5, **arguments})


def test_gymnasiums_checker_has_nothing_to_say(path):
    check_env(make(path).unwrapped, skip_render_check=True)


def test_a_path_object_is_taken_and_no_path_is_refused(path):
    assert make(Path(path)).unwrapped.config.path == path
    with pytest.raises(ArgumentError, match=r"^path must be given\.$"):
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
    starts = [env.reset(seed=seed)[1]["start"] for seed in range(30)]
    assert starts == [env.reset(seed=seed)[1]["start"] for seed in range(30)]
    assert len(set(starts)) > 4


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    """The tracks without the column of leaders."""
    place = tmp_path_factory.mktemp("tracks") / "plain.csv"
    lines = [[*row[:4]] for row in example().merging()]
    with open(place, "w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([["id", "t", "x", "y"], *lines])
    return str(place)


def test_tracks_without_leaders_can_be_played_but_not_scored(plain):
    env = make(plain)
    env.reset()
    assert env.step(np.zeros(14, np.int8))[2]
    with pytest.raises(ArgumentError, match=r"^env must know .* without a column 'leader' that names their ids\.$"):
        evaluate("USNET/Tracks-v0", "none", episodes=1, env_kwargs={"path": plain})


def test_a_record_of_tracks_without_leaders_holds_what_was_found(path, plain, tmp_path):
    detector = make_detector("directional-delays")
    known = record_episode(make(path), detector, 0, 0)
    found = record_episode(make(plain), detector, 0, 0)
    with RecordReplay(make(plain), tmp_path / "played") as env:
        observation, _ = env.reset(seed=0)
        env.note(answer := detector.detect(Window.from_observation(observation)))
        env.step(answer.candidates.astype(np.int8))
    played = EpisodeRecord.load(tmp_path / "played" / "episode-0.npz")
    assert known.labelled
    assert known.objective > 0
    for record in (found, played):
        assert not record.labelled
        np.testing.assert_array_equal(record.head, answer.candidates)
        np.testing.assert_array_equal(np.unique(record.root[0]), np.flatnonzero(answer.candidates))
        assert [int(each.sum()) for each in (record.decoys, record.fired, record.objective)] == [0, 0, 0]
        assert "the truth is unknown" in describe_outcome(record)
    np.testing.assert_array_equal(found.root, known.root)  # of these tracks the detector finds all leaders


def test_records_of_the_same_tracks_without_leaders_are_compared(plain, tmp_path):
    pytest.importorskip("rerun")
    one, other = (record_episode(make(plain), make_detector(name), 0, 0) for name in ("none", "directional-delays"))
    assert write_comparison(one, other, tmp_path / "both.rrd").exists()


def test_evaluate_scores_detectors_with_the_same_metrics_and_known_groups(path, tmp_path):
    arguments = {"path": path, "step": 0.5}
    result = evaluate(
        "USNET/Tracks-v0", ["directional-delays", "none"], episodes=6, env_kwargs=arguments, out=tmp_path / "run"
    )
    good, none = result["directional-delays"], result["none"]
    assert none["J"]["mean"] <= good["J"]["mean"]  # one round: J does not count missed heads
    assert result.conclusion().startswith("directional-delays has the highest F1: ")
    assert result.to_markdown(["f1_first"]).index("directional-delays") > 0
    assert good["recall_first"]["mean"] >= 0.9
    assert good["group_leader_first"]["mean"] >= 0.9
    assert none["group_leader_first"]["mean"] < 0.2
    again = EvaluationResult.load(tmp_path / "run")
    assert again["none"]["group_leader_first"] == none["group_leader_first"]
    assert "group_leader_first" not in evaluate("USNET/SingleCluster-v0", "none", episodes=1)["none"]


def test_a_run_is_of_the_content_of_its_file(path, tmp_path):
    head, *rows = Path(path).read_text(encoding="utf-8").splitlines()
    file, out = tmp_path / "tracks.csv", tmp_path / "run"

    def play(lines, episodes):
        file.write_text("\n".join([head, *lines]))
        arguments = {"path": str(file), "step": 0.5}
        return evaluate("USNET/Tracks-v0", "none", episodes=episodes, env_kwargs=arguments, out=out)

    play(rows, 1)
    assert len(play([*rows, "", ""], 2).rows) == 2  # the same tracks in other bytes
    first = rows[0].split(",")
    for changed in ([*first[:2], "7.5", *first[3:]], [*first[:4], rows[-1].split(",")[0]]):
        with pytest.raises(ArgumentError, match=r"with a run of tracks with other content \(SHA-256 .{12}… instead of"):
            play([",".join(changed), *rows[1:]], 3)
    text = (out / "run.json").read_text(encoding="utf-8")
    (out / "run.json").write_text(re.sub(r'"recording": "\w{64}",', "", text), encoding="utf-8")
    assert len(EvaluationResult.load(out).rows) == 2
    with pytest.raises(ArgumentError, match="with a run that does not say what its tracks held"):
        play(rows, 3)


def test_a_run_with_windows_without_leaders_is_loaded(path, tmp_path):
    head, *rows = Path(path).read_text(encoding="utf-8").splitlines()
    late = max(float(row.split(",")[1]) for row in rows) / 2
    rows = [row if float(row.split(",")[1]) > late else row.rpartition(",")[0] + "," for row in rows]
    (tmp_path / "late.csv").write_text("\n".join([head, *rows]))
    arguments = {"path": str(tmp_path / "late.csv"), "step": 0.5}
    result = evaluate("USNET/Tracks-v0", "none", episodes=6, env_kwargs=arguments, out=tmp_path / "run")
    values = [row["group_leader_first"] for row in result.rows]
    assert None in values
    assert set(values) != {None}
    assert [row["group_leader_first"] for row in EvaluationResult.load(tmp_path / "run").rows] == values


def test_without_leaders_groups_are_not_scored(path, tmp_path):
    head, *rows = Path(path).read_text(encoding="utf-8").splitlines()
    (tmp_path / "bare.csv").write_text("\n".join([head, *(row.rpartition(",")[0] + "," for row in rows)]))
    bare = {"path": str(tmp_path / "bare.csv"), "step": 0.5}
    result = evaluate("USNET/Tracks-v0", "none", episodes=2, env_kwargs=bare)["none"]
    assert "group_leader_first" not in result
    assert result["J"]["mean"] == 1


@pytest.fixture(scope="module")
def large(path, tmp_path_factory):
    """The same tracks in another unit of length: each number is 1,024 times as large."""
    place = tmp_path_factory.mktemp("tracks") / "large.csv"
    with open(path, newline="", encoding="utf-8") as file:
        head, *rows = csv.reader(file)
    with open(place, "w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([head, *([*row[:2], *(1024 * float(x) for x in row[2:4]), row[4]] for row in rows)])
    return str(place)


@pytest.mark.parametrize("isolate", [False, True])
def test_detectors_made_for_unit_speed_do_not_depend_on_the_unit_of_length(path, large, isolate):
    if isolate and sys.platform == "win32":
        pytest.skip("needs Linux or macOS")
    found = []
    for file in (path, large):
        arguments = {"path": file, "step": 0.5}
        whole = evaluate(
            "USNET/Tracks-v0",
            "lagged-regression",
            episodes=3,
            env_kwargs=arguments,
            isolate=isolate,
            secret="0" * 32 if isolate else None,
        )
        found.append([[row[name] for name in ("swarm_seed", "J", "f1_first", "ap_first")] for row in whole.rows])
    assert found[0] == found[1]


def test_recorded_play_and_policies_scale_windows_too(path, large):
    detector = make_detector("lagged-regression")
    small, big = (record_episode(make(file), detector, 0, 0) for file in (path, large))
    np.testing.assert_allclose(big.scores, small.scores, rtol=1e-4)
    np.testing.assert_allclose(big.velocity, 1024 * small.velocity, rtol=1e-3, atol=1)  # as it was seen
    observation, _ = make(large).reset(seed=0)
    action, _ = detector.as_policy().predict(observation)
    np.testing.assert_array_equal(action, small.candidates[0])


@pytest.mark.parametrize(
    ("arguments", "name"),
    [({"path": "nowhere.csv"}, "path"), ({"window": 10**5}, "length"), ({"step": 0}, "step"), ({"path": 3}, "path")],
)
def test_a_bad_argument_is_named(path, arguments, name):
    with pytest.raises(ArgumentError, match=rf"^{name} must .*, got .*\.$"):
        make(path, **arguments)
