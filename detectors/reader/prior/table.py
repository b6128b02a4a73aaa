"""The families of the simulator and their weights. None of f1 to f7 is one; two hold f1 to f6 as parts of a swarm."""

PRIOR_VERSION = 1  # increases when a draw changes

#: Parts of the whole: models seen well, models with a fault, the draws of the field environment, and the worlds.
MODEL_SHARE, FAULT_SHARE, FIELD_SHARE, WORLD_SHARE = 0.33, 0.18, 0.17, 0.32

#: Follow strategies. Flocks are the hardest, and come twice as often; the last line is of swarms that nobody leads.
MODELS = {
    "random": 2.5,
    **dict.fromkeys(("unequal_delays", "mixed", "switching", "chain", "pigeons", "cucker_smale"), 1.0),
    **dict.fromkeys(("frontness", "part_time", "partial_turns"), 1.0),
    **dict.fromkeys(("vicsek", "couzin", "informed", "predator"), 2.0),
    **{"shepherd": 1.0, "reference": 1.0, "independent": 0.7, "shifted": 0.7, "none": 0.4},
}

#: What the sensor does to a swarm that follows by one of the models.
FAULTS = {
    **{"fault:noise": 1.5, "fault:correlated": 1.5, "fault:course": 0.7, "fault:missed": 1.0, "fault:bursts": 1.0},
    **{"fault:partial": 0.8, "fault:swaps": 1.2, "fault:jumps": 0.5, "fault:rounding": 0.5, "fault:mix": 1.3},
}
