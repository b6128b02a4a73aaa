"""Estimates the calibration: fits simulated swarms with random follow strategies and compares with the true heads.

The seed of each swarm follows from the seed of the calibration and the number of the swarm. So a calibration that is
resumed gives exactly the result of an uninterrupted one, and a larger one begins with the same swarms.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from hashlib import sha256
from importlib.resources import files
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field
from scipy.optimize import minimize
from scipy.special import expit

from detectors.follow_mixture.calibration import MOST_ODDS, Calibration
from detectors.follow_mixture.fit import fit_motion
from detectors.follow_mixture.motion import read_motion
from usnet_env.arrays import Floats, Mask
from usnet_env.config import Config
from usnet_env.evaluation.store import write_text
from usnet_env.evaluation.suite import Game, Place, Suite, list_games
from usnet_env.provenance import versions
from usnet_env.swarm import SwarmConfig, advance, destroy, start
from usnet_env.swarm.random_follow import RandomFollowStrategy, random_follow_strategy
from usnet_env.window import Window

_MOBILITIES = ("iid", "gauss_markov", "smooth_turn", "local_waypoint", "waypoint", "straight")
_SMOOTH = _MOBILITIES[1:4]
_BIN = 0.25  # width of a bin of log-odds
_BINS = int(2 * MOST_ODDS / _BIN) + 1
_ODDS = np.linspace(-MOST_ODDS, MOST_ODDS, _BINS)
_EDGES = (0, 0.001, 0.003, 0.01, 0.03, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.97, 0.99, 1)
#: Prior of a calibration: mean and standard deviation of the log slope, the offset and the log-odds of the doubt.
_PRIOR = np.array([[0.0, 1.0], [0.0, 3.0], [-2.0, 2.0]])


class CalibrationTraining(Config):
    """Settings of the calibration; together with the detector they determine the result.

    Args:
        swarms: the number of swarms.
        seed: seed of all random draws.
        most_uavs: N is drawn between 20 and this.
        most_clusters: M is drawn between 1 and this.
    """

    swarms: Annotated[int, Field(ge=1, le=1_000_000)] = 600
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    most_uavs: Annotated[int, Field(ge=20, le=500)] = 150
    most_clusters: Annotated[int, Field(ge=1, le=100)] = 12


@dataclass(frozen=True)
class Draws:
    """What the draws of a swarm depend on, beside its number: the settings of :class:`CalibrationTraining`."""

    seed: int
    most_uavs: int
    most_clusters: int


@dataclass(frozen=True, kw_only=True)
class Row(Draws):
    """A swarm and its fit; :func:`draw_swarm` makes the swarm again.

    Args:
        swarm: its number.
        follows: 1 if any UAV follows another.
        living: number of living UAVs.
        heads: number of living heads that lead.
        exact: 1 if the fit has the true heads.
        log_odds: ``bin:UAVs:heads`` of every bin of uncalibrated log-odds with a UAV; empty if no UAV seemed to follow.
    """

    swarm: int
    follows: int
    living: int
    heads: int
    exact: int
    log_odds: str


def _log_uniform(rng: np.random.Generator, least: int, most: int) -> int:
    return round(math.exp(rng.uniform(math.log(least), math.log(most))))


def _linear_strategy(rng: np.random.Generator) -> RandomFollowStrategy:
    """Draw a random strategy with linear terms only; these are rare in the grammar and suit the first search."""
    while True:
        drawn = random_follow_strategy(rng)
        if all(term.kind == "linear" for term in drawn.terms):
            return drawn


def draw_swarm(draws: Draws | CalibrationTraining, rng: np.random.Generator) -> SwarmConfig:
    """Draw the configuration of a swarm and its observer.

    The grammar of the follow strategies contains none of f1 to f7. But in half of the noisy swarms with followers the
    strategy is linear and the identity replaces its rotation, so that its axes are alike. A strategy with the single
    term v_t, which would be f1, is drawn again.
    """
    uavs = _log_uniform(rng, 20, draws.most_uavs)
    decoys = int(rng.integers(1, 6)) if rng.random() < 0.3 else 0
    clusters = int(rng.integers(1, min(draws.most_clusters, (uavs - decoys) // 3) + 1))
    kind = rng.random()  # no UAV follows in 10 % of the swarms; all terms are linear in another 40 %
    follow = "none" if kind < 0.1 else _linear_strategy(rng) if kind < 0.5 else random_follow_strategy(rng)
    drawn = SwarmConfig(
        follow=follow,
        mobility="iid" if rng.random() < 0.3 else str(rng.choice(_MOBILITIES)),
        formation=str(rng.choice(["uniform", "around"], p=[0.8, 0.2])),
        clusters=clusters,
        uavs=uavs,
        observation_steps=100 if rng.random() < 0.5 else _log_uniform(rng, 12, 150),
        miss_rate=float(rng.uniform(0.0, 0.3)) if rng.random() < 0.15 else 0.0,
        position_noise=float(rng.uniform(0.1, 1.0)) if rng.random() < 0.2 else 0.0,
        decoys=decoys,
        head_jitter=bool(rng.random() < 0.5),
    )
    if drawn.position_noise > 0 and kind >= 0.1 and rng.random() < 0.5:
        # Strategies that are equal on all axes, with smooth heads, behind noise: rare otherwise.
        alike = _linear_strategy(rng)
        while len(alike.terms) == 1 and alike.terms[0].lag == 0:  # that is f1
            alike = _linear_strategy(rng)
        smooth = {"follow": replace(alike, rotation=np.eye(3, dtype=np.float32)), "mobility": str(rng.choice(_SMOOTH))}
        drawn = drawn.model_copy(update={**smooth, "head_jitter": True})
    return drawn


def draw_window(config: SwarmConfig, rng: np.random.Generator) -> tuple[Window, Mask]:
    """Draw a window of a swarm; in 20 % of the cases some UAVs were destroyed before.

    Returns:
        The window; ``(N,)`` bool, the living heads.
    """
    (own,) = rng.spawn(1)
    state = start(config, [own])
    if rng.random() < 0.2:
        chance = np.where(state.head, rng.uniform(0.0, 1.0), rng.uniform(0.0, 0.1))  # earlier rounds hit heads
        gone = rng.random((1, config.uavs)) < chance
        gone[0, rng.choice(np.flatnonzero(state.head[0]))] = False
        gone[0, rng.choice(np.flatnonzero(~state.head[0]), 2, replace=False)] = False
        state, _ = advance(config, state, [own])
        state = destroy(state, gone)
    state, sighting = advance(config, state, [own])
    window = Window(sighting.position[0], sighting.velocity[0], sighting.seen[0], sighting.alive[0])
    return window, state.head[0] & state.alive[0] & (config.follow != "none")


def play(games: Sequence[Game[Draws]]) -> list[Row]:
    """Draw swarms, fit them, and count heads and other UAVs by uncalibrated log-odds."""
    return [_play(draws, swarm) for draws, swarm in games]


def _play(draws: Draws, swarm: int) -> Row:
    rng = np.random.default_rng([draws.seed, swarm])
    config = draw_swarm(draws, rng)
    window, leads = draw_window(config, rng)
    living = np.flatnonzero(window.alive)
    head = leads[living]
    motion = read_motion(window, living)
    found = None if motion is None else fit_motion(motion, 4, None, rng)  # 4: the detector's memory by default
    counts, exact = "", not head.any()
    if found is not None:
        place = np.rint((np.clip(found.log_odds, -MOST_ODDS, MOST_ODDS) + MOST_ODDS) / _BIN).astype(np.int64)
        uavs, led = np.bincount(place, minlength=_BINS), np.bincount(place[head], minlength=_BINS)
        counts = " ".join(f"{k}:{uavs[k]}:{led[k]}" for k in np.flatnonzero(uavs).tolist())
        exact = np.array_equal(found.heads, np.flatnonzero(head))
    follows, heads = int(config.follow != "none"), int(head.sum())
    numbers = {"swarm": swarm, "follows": follows, "living": len(living), "heads": heads, "exact": int(exact)}
    return Row(**vars(draws), **numbers, log_odds=counts)


def _count(rows: Sequence[Row]) -> tuple[Floats, Floats]:
    """UAVs and heads ``(S, bins)`` of all rows."""
    uavs, heads = np.zeros((2, len(rows), _BINS))
    for number, row in enumerate(rows):
        for entry in row.log_odds.split():
            place, count, leading = map(int, entry.split(":"))
            uavs[number, place], heads[number, place] = count, leading
    return uavs, heads


def fit_calibration(rows: Sequence[Row]) -> Calibration:
    """Fit a calibration to rows of :func:`play` by maximum likelihood, with a wide prior."""
    uavs, heads = _count(rows)
    others, size, leading = uavs - heads, uavs.sum(axis=1), heads.sum(axis=1)

    def curve(values: Floats) -> Calibration:
        return Calibration(slope=math.exp(values[0]), offset=float(values[1]), doubt=float(expit(values[2])))

    def surprise(values: Floats) -> float:
        fitted = curve(values)
        share = np.clip(fitted(_ODDS), 1e-9, 1.0 - 1e-9)
        right = heads @ np.log(share) + others @ np.log1p(-share)
        mean = np.clip(uavs @ share / np.maximum(size, 1.0), 1e-9, 1.0 - 1e-9)
        wrong = leading * np.log(mean) + (size - leading) * np.log1p(-mean)
        doubt = min(max(fitted.doubt, 1e-9), 1.0 - 1e-9)
        likelihood = float(np.logaddexp(math.log1p(-doubt) + right, math.log(doubt) + wrong).sum())
        return 0.5 * float((((values - _PRIOR[:, 0]) / _PRIOR[:, 1]) ** 2).sum()) - likelihood

    options = {"xatol": 1e-6, "fatol": 1e-6, "maxiter": 4000, "maxfev": 4000}
    fitted = curve(minimize(surprise, _PRIOR[:, 0], method="Nelder-Mead", options=options).x)
    return Calibration(**{name: round(value, 5) for name, value in fitted.model_dump().items()})


def _reliability(rows: Sequence[Row]) -> tuple[Floats, dict[str, float]]:
    """Compare probabilities with the truth by two-fold cross-validation.

    Returns:
        ``(bins, 3)``: UAVs, heads and summed probability between the edges; Brier score and log loss, before and after
        calibration.
    """
    table: Floats = np.zeros((len(_EDGES) - 1, 3))
    totals: dict[str, Floats] = {name: np.zeros(3) for name in ("", ", before calibration")}
    for half in (0, 1):
        fitted = fit_calibration([row for row in rows if row.swarm % 2 != half])
        uavs, heads = _count([row for row in rows if row.swarm % 2 == half])
        for name, curve in zip(totals, (fitted, Calibration(slope=1.0, offset=0.0)), strict=True):
            share = np.clip(curve(_ODDS), 1e-9, 1.0 - 1e-9)
            brier = (heads @ (1.0 - share) ** 2 + (uavs - heads) @ share**2).sum()
            loss = -(heads @ np.log(share) + (uavs - heads) @ np.log1p(-share)).sum()
            totals[name] += brier, loss, uavs.sum()
        share, all_uavs = fitted(_ODDS), uavs.sum(axis=0)
        counts = np.stack([all_uavs, heads.sum(axis=0), all_uavs * share], axis=1)
        np.add.at(table, np.digitize(share, _EDGES[1:-1]), counts)
    scores = {}
    for name, (brier, loss, count) in totals.items():
        scores[f"brier{name}"] = round(float(brier / max(count, 1.0)), 6)
        scores[f"log loss{name}"] = round(float(loss / max(count, 1.0)), 6)
    return table, scores


def train_calibration(
    out: str | os.PathLike[str],
    training: CalibrationTraining | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
    resume: bool = True,
    workers: int | Place = 1,
) -> Path:
    """Fit swarms, count, estimate the calibration and write it.

    It writes these files to ``out``: ``calibration.json``, ``rows-HASH.csv`` (a :class:`Row` for each swarm; the hash
    is that of the detector's source files) and ``reliability.csv``.

    Args:
        out: the output folder; created if it is missing.
        training: the settings; the defaults give the shipped calibration.
        progress: function that is called with the number of finished swarms and of all swarms.
        resume: whether to resume from the rows in ``out``, if there are any.
        workers: number of processes, or a place; the result does not depend on it.

    Returns:
        The path of the calibration file.

    Raises:
        ArgumentError: an argument is refused, or ``out`` holds a file of other rows.
    """
    training = CalibrationTraining() if training is None else training
    detector, folder = _hash_detector(), Path(out)
    path = folder / f"rows-{detector[:12]}.csv"
    if not resume:
        path.unlink(missing_ok=True)
    draws = Draws(training.seed, training.most_uavs, training.most_clusters)
    suite, games = (
        Suite(Draws, Row, play, number="swarm", order=("seed", "swarm")),
        list_games([draws], training.swarms),
    )
    rows = suite.run(games, path, workers=workers, progress=progress)
    table, scores = _reliability(rows)
    bins = zip(_EDGES[:-1], _EDGES[1:], table, strict=True)
    lines = [f"{low},{high},{n:.0f},{k:.0f},{round(total / n, 6)}\n" for low, high, (n, k, total) in bins if n]
    write_text(folder / "reliability.csv", "".join(["from,to,uavs,heads,mean_probability\n", *lines]))
    made = {"command": "usnet train follow-mixture", "detector": detector, "versions": versions()}
    record = {
        "calibration": fit_calibration(rows).model_dump(mode="json"),
        "training": {**training.model_dump(mode="json"), **made},
        "metrics": {
            "uavs": sum(row.living for row in rows),
            "heads": sum(row.heads for row in rows),
            "swarms with followers": sum(row.follows for row in rows),
            "exact": sum(row.exact for row in rows),
            **scores,
        },
    }
    write_text(folder / "calibration.json", json.dumps(record, indent=2) + "\n")
    return folder / "calibration.json"


def _hash_detector() -> str:
    """A hash of the detector's source files, on which the rows depend."""
    sources = sha256()
    for source in sorted(files("detectors.follow_mixture").iterdir(), key=lambda entry: entry.name):
        if source.name.endswith(".py") and source.name != "calibration.py":
            sources.update(source.read_bytes())
    return sources.hexdigest()
