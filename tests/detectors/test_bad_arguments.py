"""Every detector refuses a bad argument when it is used, in a sentence that begins with the name of the argument."""

import pytest
from registered import made
from synthetic_windows import swarm_window

from detectors.mc_gassl.train import MetaTraining
from usnet_env import ArgumentError, make_detector

BAD = {
    "random": {"count": 0},
    "central-most": {"reach": 0.0},
    "track-outlier": {"threshold": -1.0},
    "lagged-correlation": {"clusters": 0, "max_lag": None},
    "lagged-regression": {"clusters": 2.5, "lags": "4", "squares": 1, "ridge": float("nan")},
    "granger": {"own_lags": -1},
    "factions": {"max_lag": 0, "threshold": 1.5},
    "directional-delays": {"max_lag": 0},
    "mflica": {"level": 1.0},
    "gassl": {"top_k": 0, "times": "last", "learning_rate": float("inf"), "similarity_hidden": (8, 8, 8), "gain": 0.0},
    "mc-gassl": {"start": "cold", "count": 0, "clusterer": 3},
    "neural-granger": {"steps": 1.5, "gate": 1, "device": "tpu", "voters": 1, "floor": 5e-324},
    "reader": {"policy": "best", "objective": "P3", "round_price": 0.0},
}


@pytest.mark.parametrize(("name", "argument"), [(name, argument) for name, bad in BAD.items() for argument in bad])
def test_a_bad_argument_is_refused(name, argument):
    made(name)
    window, _ = swarm_window(0, observation_steps=10)
    detector = make_detector(name, **{argument: BAD[name][argument]})
    for use in (lambda: detector.reset(0), lambda: detector.detect(window)):
        with pytest.raises(ArgumentError, match=f"^{argument} must "):
            use()


def test_more_clusters_than_uavs_are_refused():
    with pytest.raises(ArgumentError, match="clusters must be at most"):
        make_detector("lagged-regression", clusters=31).detect(swarm_window(0, observation_steps=10)[0])


@pytest.mark.parametrize("bad", [{"steps": 1.5}, {"memory": 3}, {"units": 3}])
def test_arguments_of_gassl_in_mc_gassl_are_checked(bad):
    with pytest.raises((ArgumentError, TypeError), match=next(iter(bad))):
        make_detector("mc-gassl", gassl=bad).reset(0)


@pytest.mark.parametrize("bad", [{"episodes": 0}, {"method": "maml"}, {"seed": -1}, {"inner_rate": 0.0}])
def test_bad_settings_of_a_training_are_refused(bad):
    with pytest.raises(ArgumentError, match=next(iter(bad))):
        MetaTraining(**bad)
