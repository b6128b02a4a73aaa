"""The evaluator with real environments and small real detectors."""

import json
from types import SimpleNamespace

import gymnasium as gym
import numpy as np
import pytest
from pandas.testing import assert_frame_equal
from sample_detectors import AllAlive, Followed, NoUav, RandomThird, Recorder, untimed

from usnet_env import ArgumentError, evaluate
from usnet_env.evaluation import METRICS, TRIVIAL

MULTI, SINGLE, PROBING = "USNET/MultiCluster-v0", "USNET/SingleCluster-v0", "USNET/Probing-v1"
SMALL = {"clusters": 3, "uavs": 20, "observation_steps": 20, "max_rounds": 5}


ZEROS = {"redundancy": 0, "success": 0, "exact": 0, "precision_first": 0, "recall_first": 0, "f1_first": 0}
BEST = dict.fromkeys(set(METRICS) - {"redundancy", "seconds_per_round"}, 1) | {"redundancy": 0}
ALL = {"redundancy": 17 / 20, "success": 1, "exact": 0, "precision_first": 3 / 20, "recall_first": 1}


@pytest.mark.parametrize(
    ("env_id", "detector", "settings", "expected"),
    [
        (MULTI, AllAlive(), {}, ALL | {"J": 1 + 17 / 20}),
        (MULTI, AllAlive(), {"redundancy_price": 9}, ALL | {"J": 1 + 17 / 20}),  # a price changes rewards only
        (MULTI, AllAlive(), {"shot_budget": 4}, ZEROS | {"J": 5, "rounds": 5}),  # over it, it counts as no answer
        (MULTI, NoUav(), {}, ZEROS | {"J": 5, "rounds": 5}),
        (MULTI, Followed(3), {"observation_steps": 60}, BEST),
        (SINGLE, AllAlive(), {}, {"J": -15, "success": 1, "rounds": 1}),
        (SINGLE, NoUav(), {}, {"J": -1, "success": 0, "rounds": 1}),
        (SINGLE, Followed(1), {}, {"J": 0, "success": 1, "rounds": 1}),
    ],
)
def test_the_metrics_of_plain_detectors_are_their_formulas(env_id, detector, settings, expected):
    kwargs = SMALL | settings if env_id == MULTI else settings
    (entry,) = evaluate(env_id, detector, episodes=4, env_kwargs=kwargs).summary
    metrics = entry["metrics"]
    assert {name: metrics[name]["mean"] for name in expected} == expected


def test_every_detector_meets_the_same_swarms_and_the_warm_up_leaves_it_alone():
    first, second, alone = Recorder(), Recorder(), Recorder()
    evaluate(MULTI, {"first": first, "third": RandomThird(), "second": second}, episodes=4, env_kwargs=SMALL)
    evaluate(MULTI, alone, episodes=4, env_kwargs=SMALL)
    assert len(alone.windows) == 4
    for other in (first, second):
        assert other.seeds == alone.seeds
        for ours, theirs in zip(alone.windows, other.windows, strict=True):
            assert np.array_equal(ours.position, theirs.position)
    assert len({window.position.tobytes() for window in alone.windows}) == 4


@pytest.mark.parametrize("seed", [0, 2**192 - 1])
def test_swarm_and_detector_seeds_come_from_two_branches(seed):
    """Against NumPy's own branches: published rows depend on these numbers."""
    recorder = Recorder()
    rows = evaluate(MULTI, recorder, episodes=3, seed=seed, env_kwargs=SMALL).rows
    for row, episode in zip(rows.to_dict("records"), np.random.SeedSequence(seed).spawn(3), strict=True):
        swarm, detector = episode.spawn(2)
        assert row["swarm_seed"] == int(swarm.generate_state(1, np.uint64)[0]) >> 1
        assert row["detector_seed"] == int(detector.generate_state(1)[0]) >> 1
    assert recorder.seeds == list(rows["detector_seed"])


@pytest.fixture(scope="module")
def played_here():
    detectors = [RandomThird(), "lagged-correlation(clusters=3)", NoUav(), Followed(2)]
    return detectors, evaluate(MULTI, detectors, episodes=4, seed=1, env_kwargs=SMALL)


@pytest.mark.parametrize(
    ("how", "count"),
    [
        pytest.param({"workers": 2}, 4, marks=pytest.mark.slow),
        ({"backend": "serial", "workers": 2}, 4),
        ({"isolate": True}, 1),
        pytest.param({"isolate": True, "workers": 2}, 4, marks=pytest.mark.slow),
    ],
)
def test_where_episodes_are_played_changes_no_row(how, count, played_here):
    detectors, here = played_here
    there = evaluate(MULTI, detectors[:count], episodes=4, seed=1, env_kwargs=SMALL, **how)
    assert_frame_equal(untimed(there), untimed(here)[: 4 * count])


def test_n_is_the_number_of_uavs_at_the_start_in_games_that_draw_it():
    rows = evaluate("USNET/MultiCluster-Small-v0", AllAlive(), episodes=4, seed=1).rows
    assert rows.uavs.nunique() > 1
    np.testing.assert_allclose(rows.J, 1 + (rows.uavs - rows.heads) / rows.uavs)
    env = gym.make("USNET/MultiCluster-Small-v0")
    for seed, expected in zip(rows.swarm_seed.tolist(), rows.J, strict=True):
        *_, reward, _, _, info = env.step(env.reset(seed=seed)[0]["alive"])
        assert (info["J"], -reward) == pytest.approx((expected, expected))


def test_what_gym_made_is_made_again_with_its_arguments():
    env = gym.make(MULTI, render_mode="rgb_array", **SMALL)
    theirs = evaluate(MULTI, RandomThird(), episodes=2, env_kwargs=SMALL)
    assert_frame_equal(untimed(evaluate(env, RandomThird(), episodes=2)), untimed(theirs))
    with pytest.raises(ArgumentError, match=r"^env must"):
        evaluate(env.unwrapped.__class__(), NoUav())
    with pytest.raises(ArgumentError, match=r"^env must"):
        evaluate(gym.make("CartPole-v1"), NoUav())


def test_names_classes_and_mappings_give_labels_and_the_trivial_policies_join():
    detectors = [NoUav(), Followed(2), Followed(3), "random"]
    result = evaluate(MULTI, detectors, episodes=2, env_kwargs=SMALL, trivial=True)
    others = [name for name in TRIVIAL if name != "random"]
    assert list(result) == ["NoUav", "Followed(clusters=2)", "Followed", "random", *others]
    rows = untimed(result).set_index("detector")
    assert_frame_equal(rows.loc["none"].reset_index(drop=True), rows.loc["NoUav"].reset_index(drop=True))
    named = {"my third": RandomThird(), "all": AllAlive()}
    assert list(evaluate(MULTI, named, episodes=1, env_kwargs=SMALL, trivial=True)) == ["my third", "all", *TRIVIAL]


def test_the_summary_is_plain_json_of_the_promised_form():
    result = evaluate(MULTI, [RandomThird(), Followed()], episodes=3, env_kwargs=SMALL)
    read = json.loads(json.dumps(result.summary, allow_nan=False))
    assert read == result.summary
    for entry in read:
        assert entry == {**entry, "episodes": 3, "failed": 0}
        assert entry.keys() == {"detector", "metrics", "episodes", "failed"}
        assert all(cell["low"] <= cell["mean"] <= cell["high"] for cell in entry["metrics"].values())
    assert set(read[1]["metrics"]) == set(METRICS)
    means = result.rows.groupby("detector")[list(METRICS)].mean().loc["RandomThird"].dropna().to_dict()
    assert {name: cell["mean"] for name, cell in read[0]["metrics"].items()} == pytest.approx(means)
    assert (result.rows["seconds_per_round"] > 0).all()


@pytest.mark.parametrize(
    ("changes", "name"),
    [
        *(({name: 0}, name) for name in ("episodes", "workers", "time_limit", "env_kwargs", "env")),
        *(({name: -1}, name) for name in ("seed", "memory_limit")),
        *(({"seed": 2**192}, "seed"), ({"backend": "dask"}, "backend"), ({"out": ""}, "out")),
        *(({"env": name, "env_kwargs": {}}, "env") for name in ("USNET/Multi", "nowhere:X-v0", "CartPole-v1", PROBING)),
        ({"env_kwargs": {"folow": "f1"}}, "folow"),
        ({"detector": "random(seeed=1)"}, "seeed"),
        *(({"detector": value}, "detector") for value in ([NoUav(), NoUav()], {"a\nb": NoUav()}, {3: NoUav()})),
        *(({"detector": value}, "detector") for value in ("lagged-regresion", object())),
        ({"detector": NoUav}, r"^detector must .* \(NoUav\(\) makes one\)"),
        ({"detector": []}, "^detector must name at least one"),
        ({"detector": SimpleNamespace(predict=max)}, "detector"),
        ({"detector": type("WithoutReset", (), {"detect": print})()}, "detector"),
    ],
)
def test_a_wrong_argument_is_named_and_leaves_nothing(tmp_path, changes, name):
    asked = {"env": MULTI, "detector": "none", "episodes": 1, "env_kwargs": SMALL, "out": tmp_path / "run"}
    with pytest.raises(ArgumentError, match=name):
        evaluate(**(asked | changes))
    assert list(tmp_path.iterdir()) == []
