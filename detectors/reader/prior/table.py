"""The families of the prior and how often each is drawn: the one place to read what the reader has seen.

None of f1 to f7 is a family; ``mixed`` and ``switching`` hold f1 to f6 as parts of a swarm.
"""

from __future__ import annotations

PRIOR_VERSION = 1  # increases when a draw changes

#: Follow strategies of the simulator, with a head. Flocks are the hardest, and come twice as often.
LED = {
    "random": 2.5,
    **dict.fromkeys(("unequal_delays", "mixed", "switching", "chain", "pigeons", "cucker_smale"), 1.0),
    **dict.fromkeys(("frontness", "part_time", "partial_turns"), 1.0),
    **dict.fromkeys(("vicsek", "couzin", "informed", "predator"), 2.0),
}

#: Swarms of the simulator that nobody leads.
UNLED = {"shepherd": 1.0, "reference": 1.0, "independent": 0.7, "shifted": 0.7, "none": 0.4}

MODELS = {**LED, **UNLED}

#: What the sensor does to a swarm of the simulator.
FAULTS = {
    "fault:noise": 1.5,
    "fault:correlated": 1.5,
    "fault:course": 0.7,
    "fault:missed": 1.0,
    "fault:bursts": 1.0,
    "fault:partial": 0.8,
    "fault:swaps": 1.2,
    "fault:jumps": 0.5,
    "fault:rounding": 0.5,
    "fault:mix": 1.3,
}

#: Parts of the whole: the models seen well, the models with a fault, the draws of the field, and the worlds.
MODEL_SHARE, FAULT_SHARE, FIELD_SHARE, WORLD_SHARE = 0.33, 0.18, 0.17, 0.32
