"""results/follow_mixture/ablation.md: what every rule of follow-mixture is worth."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np
from ablation_switches import GROUPS, LARGE, SWITCHES
from partial_replay import Switch

from result_pages.text import NOTICE, RESULTS, read_csv, source, table

__all__ = ["Loss", "Verdict", "judged", "paired_change", "text", "verdicts"]

FILE = "follow_mixture/ablation.csv"
LEAST = 0.005  # half a point
ENOUGH = 10  # games of a group that is judged; resampling fewer shows too little spread
LISTS = ("first", "second")
EMPTY = ("silence", "shifted")  # J there is the number of named UAVs, no cost
_RESAMPLES = 9_999
_Row = Mapping[str, str]


class Loss(NamedTuple):
    """What switching off a rule costs in one group of games: means with 95 % intervals, positive where it is worse."""

    group: str
    games: int
    exact: tuple[float, float, float]
    J: tuple[float, float, float]

    @property
    def counts(self) -> bool:
        """Whether exactness or J is worse by half a point or more, beyond the interval."""
        return self.games >= ENOUGH and any(loss[0] >= LEAST and loss[1] > 0 for loss in (self.exact, self.J))

    @property
    def largest(self) -> float:
        """The larger of both losses."""
        return max(self.exact[0], self.J[0])


@dataclass(frozen=True)
class Verdict:
    """The row of a switch.

    Args:
        switch: the switch.
        reached: the number of random swarms in which its code was reached.
        changed: the number in which it changed an intermediate result.
        answers: the number in which the answer was another one.
        random: the loss over all random swarms.
        worst: the largest loss in a group of games; ``None`` if no answer was worse anywhere.
        said: ``earns it``, ``open``, ``goes`` or ``not measured``.
    """

    switch: Switch
    reached: int
    changed: int
    answers: int
    random: Loss
    worst: Loss | None
    said: str


def paired_change(values: Sequence[float], games: int) -> tuple[float, float, float]:
    """Mean of paired differences with the percentile bootstrap's 95 % interval.

    Args:
        values: the differences other than 0.
        games: the number of all games; the other games have the difference 0.
    """
    if not values:
        return 0.0, 0.0, 0.0
    levels, counts = np.unique(np.append(np.asarray(values, np.float64), 0.0), return_counts=True)
    counts[levels == 0.0] = games - sum(value != 0.0 for value in values)
    drawn = np.random.default_rng(0).multinomial(games, counts / games, _RESAMPLES) @ levels / games
    low, high = np.quantile(drawn, [0.025, 0.975])
    return float(np.sum(values) / games), float(low), float(high)


def groups_of(row: _Row) -> list[str]:
    """The groups of games that a row belongs to."""
    tier, (first, _, rest) = row["tier"], row["cell"].partition("-")
    if tier == "random":
        return ["random", *(f"random, {mark}" for mark in row["cell"].split("-"))]
    if tier == "strategies":
        return [f"{tier}, all", f"{tier}, {rest or 'iid'}", f"{tier}, {first}"]
    return [f"{tier}, all", f"{tier}, {first}", *([f"{tier}, {rest}"] if rest else [])]


def verdicts(rows: Iterable[_Row]) -> list[Verdict]:
    """One row for each switch, in the order of the list."""
    rows = list(rows)
    played = {which: [row for row in rows if not row["switch"] and row["list"] == which] for which in LISTS}
    sizes = {which: Counter(group for row in own for group in groups_of(row)) for which, own in played.items()}
    other: dict[str, list[_Row]] = {}
    for row in rows:
        if row["switch"]:
            other.setdefault(row["switch"], []).append(row)
    found = []
    for switch in SWITCHES:
        which = LISTS[switch.second]
        whole = {(row["tier"], row["cell"], row["game"]): row for row in played[which]}
        found.append(judged(switch, other.get(switch.key, []), whole, sizes[which]))
    return found


def judged(
    switch: Switch,
    rows: Sequence[_Row],
    whole: Mapping[tuple[str, str, str], _Row],
    sizes: Mapping[str, int],
) -> Verdict:
    """The verdict on one switch.

    Args:
        switch: the switch.
        rows: the games in which it changed an answer.
        whole: the games of the whole detector.
        sizes: the number of games of each group.
    """
    random = [row for row in whole.values() if row["tier"] == "random"]
    exact: dict[str, list[float]] = {}
    J: dict[str, list[float]] = {}
    for row in rows:
        full = whole[row["tier"], row["cell"], row["game"]]
        for group in groups_of(row):
            exact.setdefault(group, []).append(float(full["exact"]) - float(row["exact"]))
            if row["J"] and row["tier"] not in EMPTY and "none" not in row["cell"].split("-"):
                sign = -1.0 if row["tier"] == "P1" else 1.0  # J_s is the larger the better
                J.setdefault(group, []).append(sign * (float(row["J"]) - float(full["J"])))
    losses = [
        Loss(
            group,
            sizes[group],
            paired_change(exact[group], sizes[group]),
            paired_change(J.get(group, []), sizes[group]),
        )
        for group in exact
    ]
    worse = [loss for loss in losses if loss.exact[0] > 0 or loss.J[0] > 0]
    worst = max(worse, key=lambda loss: (loss.counts, loss.games >= ENOUGH, loss.largest), default=None)
    if worst is not None and worst.counts:
        said = "earns it"
    elif any(loss.largest >= LEAST for loss in worse):
        said = "open"
    else:
        said = "goes" if whole else "not measured"
    if switch.group == LARGE and all(row["tier"] != "large" for row in whole.values()):
        said = "not measured"
    nothing = (0.0, 0.0, 0.0)
    total = next(
        (loss for loss in losses if loss.group == "random"), Loss("random", sizes.get("random", 0), nothing, nothing)
    )
    return Verdict(
        switch,
        sum(switch.key in row["reached"].split() for row in random),
        sum(switch.key in row["changed"].split() for row in random),
        sum(row["tier"] == "random" for row in rows),
        total,
        worst,
        said,
    )


def _points(loss: tuple[float, float, float]) -> str:
    """A loss of exactness as a change in points, with its interval."""
    mean, low, high = (-100.0 * value + 0.0 for value in loss)
    return "0" if mean == low == high == 0 else f"{mean:+.1f} ({high:+.1f} to {low:+.1f})"


def _rounds(loss: tuple[float, float, float]) -> str:
    mean, low, high = loss
    return "0" if mean == low == high == 0 else f"{mean:+.3f} ({low:+.3f} to {high:+.3f})"


def _line(verdict: Verdict) -> list[str]:
    worst = verdict.worst
    if verdict.said == "not measured":
        return [f"`{verdict.switch.key}`: {verdict.switch.what}", "", "", "", "", "", verdict.said]
    return [
        f"`{verdict.switch.key}`: {verdict.switch.what}",
        f"{verdict.reached} / {verdict.changed} / {verdict.answers}",
        _points(verdict.random.exact),
        "none" if worst is None else f"{worst.group} (n={worst.games})",
        "" if worst is None else _points(worst.exact),
        "" if worst is None else _rounds(worst.J),
        verdict.said,
    ]


@cache
def _all() -> tuple[list[Verdict], str]:
    rows = read_csv(RESULTS / FILE)
    played: dict[str, dict[str, int]] = {}
    for row in rows:
        if not row["switch"]:
            where = row["tier"] + (" (second list)" if row["list"] == "second" else "")
            cells = played.setdefault(where, {})
            cells[row["cell"]] = cells.get(row["cell"], 0) + 1
    parts = []
    for tier, cells in played.items():
        if tier.startswith("random"):
            parts.append(f"{tier} {sum(cells.values())} swarms")
        else:
            least, most = min(cells.values()), max(cells.values())
            each = str(least) if least == most else f"{least} to {most}"
            parts.append(f"{tier} {len(cells)} cells with {each} game{'s' * (most > 1)}")
    return verdicts(rows), "; ".join(parts)


def text() -> str:
    """The page."""
    found, played = _all()
    counts = Counter(verdict.said for verdict in found)
    header = (
        "switched off", "reached / changed / other answer", "random swarms, points", "largest loss in", "points",
        "mean J", "verdict",
    )  # fmt: skip
    parts = [
        NOTICE,
        "# Ablation of follow-mixture",
        "Each rule is switched off alone, and the same swarms are played again. `random` are swarms of the "
        "calibration's grammar (new draws with 20 to 60 UAVs, one window each); the other tiers are those of "
        "`benchmarks/follow_mixture.py`, on tuning seeds, with 10 games a cell at most. Differences are paired, with "
        "95 % bootstrap intervals over games. The calibration is that of the whole detector; it is not fitted again "
        "without a rule. A run that fails without a rule counts as not exact.",
        f"Played: {played}. Of the other cells, and of the tier shifted, no game was played.",
        "**reached / changed / other answer**: the number of random swarms in which the rule's code ran, in which it "
        "changed a result on the way, and in which it changed the candidates. "
        "**points**: change of the share of exact first answers; in swarms in which no UAV follows another, exact "
        'means that `policy="map"` names no UAV. **mean J**: change of J_m (J_s in P1), positive where it is worse; '
        "for random swarms the least J_m that the first round allows. **largest loss**: over groups of games: the "
        "cells of a tier with one follow strategy, those with one setting, the random swarms with one property. "
        "**verdict**: a rule *earns it* if the share of exact answers or mean J is worse without it by at least "
        f"half a point (0.005) in some group of {ENOUGH} games or more, beyond the interval. It is *open* if it "
        "is worse by as much in some group, but within the interval or in fewer games. Otherwise it *goes*. There are "
        "many groups, so some rules earn it by chance; and few games in many tiers, so a rule that goes may still "
        "matter there.",
        f"Of {len(found)} rules, {counts['earns it']} earn their place, {counts['open']} are open, {counts['goes']} go "
        f"and {counts['not measured']} are not measured.",
    ]
    for group in GROUPS:
        own = [verdict for verdict in found if verdict.switch.group == group]
        parts += [f"## {group[0].upper()}{group[1:]}", table(header, (_line(verdict) for verdict in own))]
    parts.append(source([FILE]))
    return "\n\n".join(parts) + "\n"
