"""The game that the examples with several observers train in, and how they score what they have trained."""

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
PRICE = 3.0  # of a redundant candidate: at the paper's 1, naming everybody is too good to learn anything better


def compared(detectors: Mapping[str, Any], games: int) -> dict[str, float]:
    """Let detectors play the same games, each in every observer's place; print and return the mean J_m of each."""
    means = {}
    game = usnet_observers_v0.parallel_env(**ARGUMENTS)
    for name, detector in detectors.items():
        observer = DetectorObserver(detector)
        played = [play_game(game, {"observer": observer}, seed=2022 + number) for number in range(games)]
        means[name] = sum(one.J for one in played) / games
        print(
            f"{name:20} J_m: {means[name]:.2f}   games in which all heads were found: {sum(o.success for o in played)}"
        )
    return means
