"""The games of several agents."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

from running import RESULTS, read_csv
from usnet_env.evaluation.report import group_rows

from result_pages.text import Row, mean_of, page, picture, share_of, table


def means(rows: Sequence[Row], keys: Sequence[str], columns: dict[str, str]) -> str:
    """A line for each combination of the keys; ``success`` is a rate."""
    lines = []
    for key, own in group_rows(rows, lambda row: tuple(row[name] for name in keys)).items():
        numbers = [
            share_of(own, lambda row: float(row["success"]) > 0, "seed")
            if name == "success"
            else mean_of(own, name, 2, "seed")
            for name in columns
        ]
        lines.append((*key, str(len(own)), *numbers))
    return table((*keys, "n", *columns.values()), lines)


FIRST = {"first_hits": "heads hit in round 1", "first_redundant": "redundant in round 1"}
CHOICES = {name: name for name in ("mobility", "jitter", "decoys", "delay")}


PAID = {"J": "J_m", "swarm_payoff": "J_m minus the price", "success": "all heads hit"}
SEEN = {"J": "J_m", "success": "all heads hit", **FIRST, "seen_in_round_1": "UAVs seen in round 1"}


@cache
def payoff() -> str:
    rows = sorted(read_csv(RESULTS / "multiagent_payoff.csv"), key=lambda row: row["follow"])
    return means(rows, ("follow", "observer", "swarm"), {**PAID, **FIRST})


@cache
def trained() -> str:
    return means(read_csv(RESULTS / "multiagent_ppo.csv"), ("detector", "follow", "swarm"), {**PAID, **CHOICES})


@cache
def observers() -> str:
    return means(read_csv(RESULTS / "multiagent_observers.csv"), ("detector", "range", "observers", "fusion"), SEEN)


def text() -> str:
    return page(
        "Games of several agents",
        "Seeds from 2022; M = 5, N = 82.",
        "## Scripted swarms",
        "`usnet_evasion_v0`, at most 10 rounds: every observer against every swarm policy. `late`: a delay of 4 steps; "
        "`camouflaged`: smooth turns, 2 decoys and a delay of 4 steps. The swarm pays a price for what its heads do.",
        payoff(),
        "## A swarm trained by PPO",
        "All heads make the same choice; one training for each line.",
        trained(),
        picture("Learning curves", "multiagent_ppo.png"),
        "## Several observers",
        "`usnet_observers_v0`, f1, at most 20 rounds, all observers with the same detector. `range` is in metres.",
        observers(),
        files=["multiagent_payoff.csv", "multiagent_ppo.csv", "multiagent_ppo_curve.csv", "multiagent_observers.csv"],
    )
