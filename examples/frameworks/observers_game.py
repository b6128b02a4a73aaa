"""The game of the examples with several observers, and the comparison at their end."""

from collections.abc import Mapping
from typing import Any

from usnet_env.multiagent import usnet_observers_v0
from usnet_env.multiagent.play import play_game
from usnet_env.multiagent.policies import DetectorObserver

UAVS = 12
ARGUMENTS = {
    "observers": 3,
    "sensing_range": 700.0,
    "clusters": 2,
    "uavs": UAVS,
    "observation_steps": 20,
    "max_rounds": 5,
}
PRICE = 3.0  # of a redundant candidate; at the paper's 1, naming all UAVs is too good to learn anything better


def compare_detectors(detectors: Mapping[str, Any], games: int) -> dict[str, float]:
    """Let all observers use the same detector, for each detector; print and return its mean J_m."""
    means = {}
    game = usnet_observers_v0.parallel_env(**ARGUMENTS)
    for name, detector in detectors.items():
        observer = DetectorObserver(detector)
        played = [play_game(game, {"observer": observer}, seed=2022 + number) for number in range(games)]
        means[name] = sum(one.J for one in played) / games
        print(f"{name:20} J_m: {means[name]:.2f}   games in which all heads were hit: {sum(o.success for o in played)}")
    return means
