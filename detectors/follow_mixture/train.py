"""Estimates the calibration: fits simulated swarms with random follow strategies and compares with the true heads.

The seed of each swarm follows from the seed of the calibration and the number of the swarm. So a calibration that is
resumed gives exactly the result of an uninterrupted one, and a larger one begins with the same swarms.
"""

from __future__ import annotations

import csv
import gzip
import io
import json
import math
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from hashlib import sha256
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.optimize import minimize
from scipy.special import expit

from detectors.follow_mixture.calibration import (
    MOST_ODDS,
    VERDICTS,
    Belief,
    Calibration,
    Curve,
    Curves,
    Rates,
    log_odds,
    verdict,
)
from detectors.follow_mixture.explain import explain
from detectors.follow_mixture.explanation import KINDS
from detectors.follow_mixture.samples import samples_of
from usnet_env.config import ArgumentError, Config, quote
from usnet_env.files import atomic_write
from usnet_env.provenance import versions
from usnet_env.swarm import SwarmConfig, advance, destroy, start
from usnet_env.swarm.random_follow import RandomFollowStrategy, random_follow_strategy
from usnet_env.window import Window

__all__ = [
    "COLUMNS",
    "CalibrationTraining",
    "draw_swarm",
    "draw_window",
    "fit_calibration",
    "read_rows",
    "row_of",
    "train_calibration",
]

Floats = NDArray[np.float64]
Rows = Sequence[Mapping[str, str]]

COLUMNS = (
    "swarm", "follows", "terms", "mobility", "head_jitter", "clusters", "uavs", "observation_steps", "position_noise",
    "miss_rate", "decoys", "later", "living", "heads", "way", "kinds", "probability", "given",
)  # fmt: skip
_MOBILITIES = ("iid", "gauss_markov", "smooth_turn", "local_waypoint", "waypoint", "straight")
_SMOOTH = ("gauss_markov", "smooth_turn", "local_waypoint")
_MEMORY = 4  # the detector's default
_BIN = 0.25  # width of a bin of log-odds
_BINS = int(2 * MOST_ODDS / _BIN) + 1
_ODDS = np.tile(np.linspace(-MOST_ODDS, MOST_ODDS, _BINS), 2)
_LEFT = np.arange(2 * _BINS) >= _BINS
_EDGES = (0, 0.001, 0.003, 0.01, 0.03, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.97, 0.99, 1)
_ROWS, _FITTED, _RELIABILITY, _IDENTITY = "rows.csv", "calibration.json", "reliability.csv", "rows.json"
_KEEP_EVERY = 20  # swarms between two writes of the rows
#: Prior of a curve: mean and standard deviation of the log slope, the offset, the addition for unassigned UAVs, and the
#: log-odds of trust.
_PRIOR = np.array([[0.0, 1.0], [0.0, 3.0], [0.0, 3.0], [2.0, 2.0]])


class CalibrationTraining(Config):
    """Settings of the calibration; together with the detector they determine the result.

    Args:
        swarms: the number of swarms.
        seed: seed of all random draws.
        most_uavs: N is drawn between 20 and this.
        most_clusters: M is drawn between 1 and this.
    """

    swarms: Annotated[int, Field(ge=1, le=1_000_000)] = 1500
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    most_uavs: Annotated[int, Field(ge=20, le=500)] = 150
    most_clusters: Annotated[int, Field(ge=1, le=100)] = 12


def _log_uniform(rng: np.random.Generator, least: int, most: int) -> int:
    return round(math.exp(rng.uniform(math.log(least), math.log(most))))


def _linear_strategy(rng: np.random.Generator) -> RandomFollowStrategy:
    """Draw a random strategy with linear terms only; these are rare in the grammar and suit the first search."""
    while True:
        drawn = random_follow_strategy(rng)
        if all(term.kind == "linear" for term in drawn.terms):
            return drawn


def draw_swarm(training: CalibrationTraining, rng: np.random.Generator) -> SwarmConfig:
    """Draw the configuration of a swarm and its observer.

    The grammar of the follow strategies contains none of f1 to f7. But in half of the noisy swarms with followers the
    strategy is linear and the identity replaces its rotation, so that its axes are alike. A strategy with the single
    term v_t, which would be f1, is drawn again. A sum of two lags can be close to f2: among the 1,500 swarms of the
    shipped calibration one or two are (number 1457, and less so 895).
    """
    uavs = _log_uniform(rng, 20, training.most_uavs)
    decoys = int(rng.integers(1, 6)) if rng.random() < 0.3 else 0
    clusters = int(rng.integers(1, min(training.most_clusters, (uavs - decoys) // 3) + 1))
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
        # Strategies that are equal on all axes, with smooth heads: rare otherwise, and used by the cross-spectral fit.
        alike = _linear_strategy(rng)
        while len(alike.terms) == 1 and alike.terms[0].lag == 0:  # that is f1
            alike = _linear_strategy(rng)
        smooth = {"follow": replace(alike, rotation=np.eye(3, dtype=np.float32)), "mobility": str(rng.choice(_SMOOTH))}
        drawn = drawn.model_copy(update={**smooth, "head_jitter": True})
    return drawn


def draw_window(config: SwarmConfig, rng: np.random.Generator) -> tuple[Window, NDArray[np.bool_], bool]:
    """Draw a window of a swarm; in 20 % of the cases some UAVs were destroyed before.

    Returns:
        The window; ``(N,)`` bool, the living heads; whether some UAVs were destroyed before.
    """
    (own,) = rng.spawn(1)
    state = start(config, [own])
    later = bool(rng.random() < 0.2)
    if later:
        chance = np.where(state.head, rng.uniform(0.0, 1.0), rng.uniform(0.0, 0.1))  # earlier rounds hit heads
        gone = rng.random((1, config.uavs)) < chance
        gone[0, rng.choice(np.flatnonzero(state.head[0]))] = False
        gone[0, rng.choice(np.flatnonzero(~state.head[0]), 2, replace=False)] = False
        state, _ = advance(config, state, [own])
        state = destroy(state, gone)
    state, sighting = advance(config, state, [own])
    window = Window(sighting.position[0], sighting.velocity[0], sighting.seen[0], sighting.alive[0])
    return window, state.head[0] & state.alive[0] & (config.follow != "none"), later


def _told(place: NDArray[np.int64], head: NDArray[np.bool_], names: Sequence[Any]) -> str:
    """``name:uavs:heads`` of every place with at least one UAV, joined by spaces."""
    uavs = np.bincount(place, minlength=len(names))
    heads = np.bincount(place[head], minlength=len(names))
    return " ".join(f"{names[k]}:{uavs[k]}:{heads[k]}" for k in np.flatnonzero(uavs).tolist())


def _placed(probability: Floats, left: NDArray[np.bool_] | None) -> NDArray[np.int64]:
    """Bins of log-odds; unassigned UAVs have separate bins after the others."""
    place = np.rint((log_odds(probability) + MOST_ODDS) / _BIN)
    return np.asarray(place if left is None else place + _BINS * left, np.int64)


def row_of(training: CalibrationTraining, swarm: int) -> dict[str, str]:
    """Draw a swarm, fit it, and count heads and other UAVs by uncalibrated result.

    Args:
        training: the settings.
        swarm: the number of the swarm.

    Returns:
        The values by :data:`COLUMNS`: ``way`` is ``mixture``, the reliability class of a flock fit, or empty if there
        was no result; ``kinds``, ``probability`` and ``given`` hold ``category or bin:UAVs:heads``.
    """
    rng = np.random.default_rng([training.seed, swarm])
    config = draw_swarm(training, rng)
    window, leads, later = draw_window(config, rng)
    living = np.flatnonzero(window.alive)
    head = leads[living]
    samples = samples_of(window, living, _MEMORY)
    found = None if samples is None else explain(window, samples, living, None, rng)
    way = kinds = probability = given = ""
    if found is not None and found.kind is not None:
        way, kinds = "mixture", _told(found.kind, head, KINDS)
    elif found is not None:
        way = verdict(found)
        probability, given = (
            _told(_placed(raw, found.left), head, range(2 * _BINS)) for raw in (found.probability, found.given)
        )
    terms = [term.kind for term in config.follow.terms] if isinstance(config.follow, RandomFollowStrategy) else []
    values = (
        swarm, int(config.follow != "none"), "+".join(terms), config.mobility, int(config.head_jitter),
        config.clusters, config.uavs, config.observation_steps, round(config.position_noise, 3),
        round(config.miss_rate, 3), config.decoys, int(later), len(living), int(head.sum()),
        way, kinds, probability, given,
    )  # fmt: skip
    return dict(zip(COLUMNS, map(str, values), strict=True))


def _entries(text: str) -> Iterable[tuple[str, int, int]]:
    for entry in text.split():
        name, uavs, heads = entry.split(":")
        yield name, int(uavs), int(heads)


def _fitted_rates(rows: Rows) -> Rates:
    """Share of heads per category, with a prior of one more UAV at the overall share of heads."""
    living, leading = (max(sum(int(row[name]) for row in rows), 1) for name in ("living", "heads"))
    counts = {kind: np.array([1.0, min(leading / living, 0.5)]) for kind in KINDS}
    for row in rows:
        for kind, uavs, heads in _entries(row["kinds"]):
            counts[kind] += uavs, heads
    return Rates(**{kind: round(float(heads / uavs), 6) for kind, (uavs, heads) in counts.items()})


def _counted(rows: Rows, column: str) -> tuple[Floats, Floats]:
    """Counts of UAVs and of heads ``(S, 2 bins)`` of every row."""
    uavs, heads = np.zeros((2, len(rows), 2 * _BINS))
    for number, row in enumerate(rows):
        for place, count, leading in _entries(row[column]):
            uavs[number, int(place)], heads[number, int(place)] = count, leading
    return uavs, heads


def _fitted_curve(rows: Rows, column: str, whole: bool) -> Curve:
    """Fit a curve by maximum a posteriori.

    Args:
        rows: the rows of one reliability class.
        column: ``"probability"`` or ``"given"``.
        whole: whether a fit is right or wrong for the whole swarm; otherwise UAVs are independent.
    """
    uavs, heads = _counted(rows, column)
    others = uavs - heads
    size, leading = uavs.sum(axis=1), heads.sum(axis=1)

    def surprise(values: Floats) -> float:
        share = np.clip(expit(math.exp(values[0]) * _ODDS + values[1] + values[2] * _LEFT), 1e-9, 1.0 - 1e-9)
        right = heads @ np.log(share) + others @ np.log1p(-share)
        prior = 0.5 * float((((values - _PRIOR[:, 0]) / _PRIOR[:, 1]) ** 2).sum())
        if not whole:
            return prior - float(right.sum())
        mean = uavs @ share / np.maximum(size, 1.0)
        wrong = leading * np.log(mean) + (size - leading) * np.log1p(-mean) if len(rows) else right
        trust = float(np.clip(expit(values[3]), 1e-9, 1.0 - 1e-9))
        return prior - float(np.logaddexp(math.log(trust) + right, math.log1p(-trust) + wrong).sum())

    best = minimize(
        surprise,
        _PRIOR[:, 0],
        method="Nelder-Mead",
        options={"xatol": 1e-6, "fatol": 1e-6, "maxiter": 4000, "maxfev": 4000},
    ).x
    trust = min(max(float(expit(best[3])), 1e-4), 1.0) if whole else 1.0
    slope, offset, left = math.exp(best[0]), float(best[1]), float(best[2])
    return Curve(slope=round(slope, 5), offset=round(offset, 5), left=round(left, 5), trust=round(trust, 5))


def _belief(rows: Rows, column: str, whole: bool) -> Belief:
    curves = {said: _fitted_curve([row for row in rows if row["way"] == said], column, whole) for said in VERDICTS}
    return Belief(rates=_fitted_rates(rows), curves=Curves(**curves))


def fit_calibration(rows: Rows) -> Calibration:
    """Fit a calibration to rows of :func:`row_of`; ``given`` is fitted to the swarms with heads only."""
    led = [row for row in rows if row["follows"] == "1"]
    return Calibration(probability=_belief(rows, "probability", False), given=_belief(led, "given", True))


def _probabilities(row: Mapping[str, str], belief: Belief | None) -> Iterable[tuple[float, int, int]]:
    """Probability, UAVs and heads of every category or bin; ``None``: of flock fits, before calibration."""
    if belief is not None:
        for kind, uavs, heads in _entries(row["kinds"]):
            yield getattr(belief.rates, kind), uavs, heads
    for place, uavs, heads in _entries(row["probability"]):
        before, left = expit(_ODDS[int(place)]), bool(_LEFT[int(place)])
        curve = None if belief is None else getattr(belief.curves, row["way"])
        yield float(before if curve is None else curve(before, left)), uavs, heads


def _reliability(rows: Rows) -> tuple[Floats, dict[str, float]]:
    """Compare probabilities with the truth by two-fold cross-validation.

    Returns:
        ``(bins, 3)``: UAVs, heads and summed probability between the edges; Brier score and log loss, also for flock
        fits before and after calibration.
    """
    table: Floats = np.zeros((len(_EDGES) - 1, 3))
    totals: dict[str, Floats] = {name: np.zeros(3) for name in ("all", "flocks", "flocks before")}
    for half in (0, 1):
        belief = fit_calibration([row for row in rows if int(row["swarm"]) % 2 != half]).probability
        for row in (row for row in rows if int(row["swarm"]) % 2 == half):
            for p, uavs, heads in _probabilities(row, belief):
                table[np.digitize(p, _EDGES[1:-1])] += uavs, heads, uavs * p
                totals["all"] += _scores(p, uavs, heads)
                if not row["kinds"]:
                    totals["flocks"] += _scores(p, uavs, heads)
            for p, uavs, heads in _probabilities(row, None):
                totals["flocks before"] += _scores(p, uavs, heads)
    scores = {}
    for name, total in totals.items():
        brier, loss = (total[:2] / max(total[2], 1.0)).tolist()
        scores[f"brier, {name}"] = round(brier, 6)
        scores[f"log loss, {name}"] = round(loss, 6)
    return table, scores


def _scores(p: float, uavs: int, heads: int) -> Floats:
    p = min(max(p, 1e-9), 1.0 - 1e-9)
    brier = heads * (1.0 - p) ** 2 + (uavs - heads) * p**2
    return np.array([brier, -heads * math.log(p) - (uavs - heads) * math.log1p(-p), uavs])


def train_calibration(
    out: str | os.PathLike[str],
    training: CalibrationTraining | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
    resume: bool = True,
) -> Path:
    """Fit swarms, count, estimate the calibration and write it.

    It writes these files to ``out``, each atomically: ``calibration.json``, ``rows.csv`` (one row per swarm, see
    :func:`row_of`), ``rows.json`` (the settings of these rows) and ``reliability.csv``.

    Args:
        out: the output folder; created if it is missing.
        training: the settings; the defaults give the shipped calibration.
        progress: function that is called with the number of finished swarms and of all swarms.
        resume: whether to resume from the rows in ``out``, if there are any.

    Returns:
        The path of the calibration file.

    Raises:
        ArgumentError: an argument is refused, ``out`` can't be written, or its rows belong to other settings or to
            another version of the detector.
    """
    training = CalibrationTraining() if training is None else training
    folder = Path(out)
    path, identity = folder / _ROWS, _identity(training)
    rows: list[dict[str, str]] = []
    if resume and path.exists():
        if not (folder / _IDENTITY).exists() or (folder / _IDENTITY).read_text(encoding="utf-8") != identity:
            raise ArgumentError(
                f"out must hold no rows of other draws or of another version of the detector (start again with "
                f"resume=False, or elsewhere), got {quote(str(folder))}."
            )
        rows = read_rows(path)[: training.swarms]
    _write(folder / _IDENTITY, identity)
    while len(rows) < training.swarms:
        rows.append(row_of(training, len(rows)))
        progress(len(rows), training.swarms)
        if len(rows) % _KEEP_EVERY == 0 or len(rows) == training.swarms:
            _write(path, _as_csv(COLUMNS, (tuple(row.values()) for row in rows)))
    table, scores = _reliability(rows)
    bins = zip(_EDGES[:-1], _EDGES[1:], table, strict=True)
    lines = [(low, high, int(n), int(k), round(total / n, 6)) for low, high, (n, k, total) in bins if n]
    _write(folder / _RELIABILITY, _as_csv(("from", "to", "uavs", "heads", "mean_probability"), lines))
    record = {
        "calibration": fit_calibration(rows).model_dump(mode="json"),
        "training": {
            **training.model_dump(mode="json"),
            "command": f"usnet train follow-mixture --swarms {training.swarms} --seed {training.seed}",
            "detector": json.loads(identity)["detector"],
            "versions": versions(),
        },
        "metrics": {
            "uavs": sum(int(row["living"]) for row in rows),
            "heads": sum(int(row["heads"]) for row in rows),
            "swarms": {
                way or "nothing said": sum(row["way"] == way for row in rows) for way in ("mixture", *VERDICTS, "")
            },
            **scores,
        },
    }
    _write(folder / _FITTED, json.dumps(record, indent=2) + "\n")
    return folder / _FITTED


def _identity(training: CalibrationTraining) -> str:
    """The settings and a hash of the detector's source files; rows can only be resumed if both are equal."""
    sources = sha256()
    package = files("detectors.follow_mixture")
    for source in sorted(
        (entry for entry in package.iterdir() if entry.name.endswith(".py")), key=lambda one: one.name
    ):
        if source.name not in ("calibration.py", "policy.py"):  # the rows do not depend on these
            sources.update(source.read_bytes())
    draws = training.model_dump(mode="json", exclude={"swarms"})
    return json.dumps({**draws, "detector": sources.hexdigest()}, indent=2) + "\n"


def _as_csv(names: Sequence[str], lines: Iterable[Sequence[Any]]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(names)
    writer.writerows(lines)
    return text.getvalue()


def _write(path: Path, text: str) -> None:
    with atomic_write(path) as aside:
        aside.write_text(text, encoding="utf-8")


def read_rows(path: str | os.PathLike[str]) -> list[dict[str, str]]:
    """Read rows written by :func:`train_calibration`; ``.gz`` files work too.

    Raises:
        ArgumentError: the file is missing or holds something else.
    """
    try:
        data = Path(path).read_bytes()
        text = (gzip.decompress(data) if str(path).endswith(".gz") else data).decode("utf-8")
        rows = list(csv.DictReader(io.StringIO(text)))
    except (OSError, EOFError, UnicodeDecodeError, csv.Error) as error:
        raise ArgumentError(f"path must be a file of rows, got {quote(str(path))}: {error}.") from None
    numbered = all(row.get("swarm") == str(number) for number, row in enumerate(rows))
    if not numbered or any(set(row) != set(COLUMNS) for row in rows):
        raise ArgumentError(f"path must hold rows of this calibration, got {quote(str(path))}.")
    return rows
