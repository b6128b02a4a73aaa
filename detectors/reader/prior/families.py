"""The families of the prior with their weights, none of them one of f1 to f7; and how names and numbers are drawn."""

from collections.abc import Collection, Mapping

import numpy as np

from usnet_env.arrays import Floats

PRIOR_VERSION = 10  # increases when a draw changes

MODELS = {  # follow strategies; flocks are the hardest, and come twice as often; two hold f1 to f6 as parts
    "random": 2.5,
    **dict.fromkeys(("unequal_delays", "mixed", "switching", "chain", "pigeons", "cucker_smale"), 1.0),
    **dict.fromkeys(("frontness", "part_time", "partial_turns"), 1.0),
    **dict.fromkeys(("vicsek", "couzin", "predator"), 2.0),
    "informed": 3.5,
    "reference": 3.0,  # no UAV leads in this and in the next models
    **dict.fromkeys(("shepherd", "independent", "shifted", "none"), 1.0),
}
LAWS = {"random_law": 1.0}  # follow strategies without a name
FAULTS = {  # what the sensor does to a swarm that follows by one of the models
    **dict.fromkeys(("fault:noise", "fault:correlated", "fault:mix"), 1.4),
    **dict.fromkeys(("fault:course", "fault:missed", "fault:bursts", "fault:partial"), 0.9),
    **dict.fromkeys(("fault:jumps", "fault:rounding"), 0.8),
    "fault:swaps": 2.0,
}
WORLDS = {  # without the simulator
    "star": 3.5,
    "path": 1.5,
    "springs": 8.5,
    **dict.fromkeys(("people", "initiators", "set_off"), 0.5),
    "graded": 2.0,
    "file": 0.8,
    "boids_signed": 0.4,
    "cars": 2.0,
    **dict.fromkeys(("changes", "fission", "convoy"), 0.3),
    "formation": 6.5,
    "factions": 4.0,
    "turn_rate": 2.5,
    "driver": 1.5,  # no UAV leads in this and the next worlds
    "route": 1.2,
    "springs_unseen": 6.0,  # about as often, so that a doubt isn't a name
    **dict.fromkeys(("leaderless", "strangers", "herd", "unled", "driven"), 2.0),
    **dict.fromkeys(("walkers", "ring_road"), 0.5),
}
#: How often a sensor spoils a world. With noise, an unseen driver can't be told from a leader, who is more likely.
OBSERVED = {"star": 0.5, "path": 0.4, "driver": 0.1, "formation": 0.4, "strangers": 0.4}  # the others: 0.25
_SHORT = ("formation", "factions", "strangers", "unled", "driven")  # more often seen for less than 100 steps
#: Of the windows; the last: the field environment.
SHARES = (0.17, MODELS), (0.16, LAWS), (0.13, FAULTS), (0.42, WORLDS), (0.12, {"field": 1.0})


def draw_name(rng: np.random.Generator, weights: Mapping[str, float], without: Collection[str] = ()) -> str:
    """Draw a name by its weight, but none of ``without``."""
    shares = {name: weight for name, weight in weights.items() if name not in without}
    return list(shares)[int(rng.choice(len(shares), p=np.array(list(shares.values())) / sum(shares.values())))]


def draw_log(rng: np.random.Generator, low: float, high: float, *shape: int) -> Floats:
    """Draw log-uniform numbers of a shape, by default one."""
    return np.exp(rng.uniform(np.log(low), np.log(high), shape))


def draw_whole(rng: np.random.Generator, low: int, high: int) -> int:
    """Draw one log-uniform whole number, both ends included."""
    return int(np.clip(np.rint(draw_log(rng, low - 0.49, high + 0.49)), low, high))


def draw_steps(rng: np.random.Generator, family: str) -> int:
    """Draw T, the steps of a window of a family."""
    p_usual, shortest, longest = (0.3, 18.0, 110.0) if family in _SHORT else (0.55, 20.0, 200.0)
    return 100 if rng.random() < p_usual else round(float(draw_log(rng, shortest, longest)))
