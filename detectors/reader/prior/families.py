"""The families of the prior with their weights, none of them one of f1 to f7; and how names and numbers are drawn."""

from collections.abc import Collection, Mapping

import numpy as np

from usnet_env.arrays import Floats

PRIOR_VERSION = 9  # increases when a draw changes

MODELS = {  # follow strategies; flocks are the hardest, and come twice as often; two hold f1 to f6 as parts
    "random": 2.5,
    **dict.fromkeys(("unequal_delays", "mixed", "switching", "chain", "pigeons", "cucker_smale"), 1.0),
    **dict.fromkeys(("frontness", "part_time", "partial_turns"), 1.0),
    **dict.fromkeys(("vicsek", "couzin", "predator"), 2.0),
    "informed": 3.5,
    "reference": 3.0,  # no UAV leads in this and in the next models
    **dict.fromkeys(("shepherd", "independent", "shifted", "none"), 1.0),
}
FAULTS = {  # what the sensor does to a swarm that follows by one of the models
    **dict.fromkeys(("fault:noise", "fault:correlated", "fault:mix"), 1.4),
    **dict.fromkeys(("fault:course", "fault:missed", "fault:bursts", "fault:partial"), 0.9),
    **dict.fromkeys(("fault:jumps", "fault:rounding"), 0.8),
    "fault:swaps": 2.0,
}
WORLDS = {  # without the simulator
    "star": 9.0,
    "path": 3.5,
    "springs": 30.0,
    **dict.fromkeys(("people", "initiators", "set_off"), 1.4),
    "graded": 2.0,
    **dict.fromkeys(("file", "boids_signed"), 1.0),
    "cars": 4.0,
    **dict.fromkeys(("changes", "fission", "convoy"), 0.7),
    "driver": 3.5,  # no UAV leads in this and the next worlds
    "route": 3.0,
    "leaderless": 5.0,
    "herd": 2.0,
    **dict.fromkeys(("walkers", "ring_road", "springs_unseen"), 1.0),
}
#: How often a sensor spoils a world. With noise, an unseen driver can't be told from a leader, who is more likely.
OBSERVED = {"star": 0.5, "path": 0.4, "driver": 0.1}  # the others: 0.25
SHARES = (0.24, MODELS), (0.15, FAULTS), (0.44, WORLDS), (0.17, {"field": 1.0})  # the last: the field environment


def draw_name(rng: np.random.Generator, weights: Mapping[str, float], without: Collection[str] = ()) -> str:
    """Draw a name by its weight, but none of ``without``."""
    left = {name: weight for name, weight in weights.items() if name not in without}
    return list(left)[int(rng.choice(len(left), p=np.array(list(left.values())) / sum(left.values())))]


def draw_log(rng: np.random.Generator, low: float, high: float, *shape: int) -> Floats:
    """Draw log-uniform numbers of a shape, by default one."""
    return np.exp(rng.uniform(np.log(low), np.log(high), shape))


def draw_whole(rng: np.random.Generator, low: int, high: int) -> int:
    """Draw one log-uniform whole number, both ends included."""
    return int(np.clip(np.rint(draw_log(rng, low - 0.49, high + 0.49)), low, high))
