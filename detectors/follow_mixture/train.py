"""Estimates the calibration: fits simulated swarms with random follow strategies and compares with the true heads.

The seed of each swarm follows from the seed of the calibration and the number of the swarm. So a calibration that is
resumed gives exactly the result of an uninterrupted one, and a larger one begins with the same swarms.
"""

from __future__ import annotations

import json
import math
import os
from collections import defaultdict
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pandas as pd
from pydantic import Field
from scipy.optimize import minimize
from scipy.special import expit

from detectors.follow_mixture.calibration import MOST_ODDS, Calibration
from detectors.follow_mixture.fit import fit_motion
from detectors.follow_mixture.motion import read_motion
from detectors.random_swarms import draw_calibration_swarm, draw_calibration_window
from usnet_env.arrays import Floats
from usnet_env.config import ArgumentError, Config, quote
from usnet_env.evaluation.run import map_tasks
from usnet_env.files import reserve_folder, write_text

_BIN = 0.25  # width of a bin of log-odds
_BINS = int(2 * MOST_ODDS / _BIN) + 1
_ODDS = np.linspace(-MOST_ODDS, MOST_ODDS, _BINS)
_DEFAULTS = 4, 12  # memory and max_lag of the detector
#: Prior of a calibration: mean and standard deviation of the log slope, the offset and the log-odds of the doubt.
_PRIOR = np.array([[0.0, 1.0], [0.0, 3.0], [-2.0, 2.0]])


class CalibrationTraining(Config):
    """Settings of the calibration; together with the detector they determine the result.

    Args:
        swarms: the number of swarms.
        seed: seed of all random draws.
        most_uavs, most_clusters: N is drawn between 20 and the one, M between 1 and the other.
    """

    swarms: Annotated[int, Field(ge=1, le=1_000_000)] = 600
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    most_uavs: Annotated[int, Field(ge=20, le=500)] = 150
    most_clusters: Annotated[int, Field(ge=1, le=100)] = 12


def fit_swarm(training: CalibrationTraining, swarm: int) -> dict[str, Any]:
    """Draw a swarm, fit it, and count heads and other UAVs by uncalibrated log-odds.

    Returns:
        A row: the settings of the draws; ``swarm``, its number; ``follows``, 1 if any UAV follows another; ``living``,
        the number of living UAVs; ``heads``, that of living heads that lead; ``exact``, 1 if the fit has the true
        heads; ``log_odds``, ``bin:UAVs:heads`` of every bin of log-odds with a UAV, empty if no UAV seemed to follow.
    """
    rng = np.random.default_rng([training.seed, swarm])
    config = draw_calibration_swarm(training.most_uavs, training.most_clusters, rng)
    window, leads = draw_calibration_window(config, rng)
    living = np.flatnonzero(window.alive)
    head, motion = leads[living], read_motion(window, living)
    found = None if motion is None else fit_motion(motion, *_DEFAULTS, None, rng)
    counts, exact = "", not head.any()
    if found is not None:
        place = np.rint((np.clip(found.log_odds, -MOST_ODDS, MOST_ODDS) + MOST_ODDS) / _BIN).astype(np.int64)
        uavs, led = np.bincount(place, minlength=_BINS), np.bincount(place[head], minlength=_BINS)
        counts = " ".join(f"{k}:{uavs[k]}:{led[k]}" for k in np.flatnonzero(uavs).tolist())
        exact = np.array_equal(found.heads, np.flatnonzero(head))
    numbers = {"swarm": swarm, "follows": int(config.follow != "none"), "living": len(living)}
    drawn = training.model_dump(exclude={"swarms"})
    return {**drawn, **numbers, "heads": int(head.sum()), "exact": int(exact), "log_odds": counts}


def _count(rows: pd.DataFrame) -> tuple[Floats, Floats]:
    """UAVs and heads ``(S, bins)`` of all rows."""
    counts = np.zeros((len(rows), _BINS, 2))
    for number, entries in enumerate(rows["log_odds"]):
        for place, *count in (map(int, entry.split(":")) for entry in entries.split()):
            counts[number, place] = count
    return counts[..., 0], counts[..., 1]


def fit_calibration(rows: pd.DataFrame) -> Calibration:
    """Fit a calibration to rows of :func:`fit_swarm` by maximum likelihood, with a wide prior."""
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


def _score(rows: pd.DataFrame) -> dict[str, float]:
    """Brier score and log loss of the probabilities by two-fold cross-validation, before and after calibration."""
    totals: dict[str, float] = defaultdict(float)
    count = 0.0
    for half in (0, 1):
        fitted = fit_calibration(rows[rows["swarm"] % 2 != half])
        uavs, heads = _count(rows[rows["swarm"] % 2 == half])
        count += uavs.sum()
        for name, curve in (("", fitted), (", before calibration", Calibration(slope=1.0, offset=0.0))):
            share = np.clip(curve(_ODDS), 1e-9, 1.0 - 1e-9)
            totals[f"brier{name}"] += (heads @ (1.0 - share) ** 2 + (uavs - heads) @ share**2).sum()
            totals[f"log loss{name}"] -= (heads @ np.log(share) + (uavs - heads) @ np.log1p(-share)).sum()
    return {name: round(float(total) / max(count, 1.0), 6) for name, total in totals.items()}


def train_calibration(
    out: str | os.PathLike[str],
    training: CalibrationTraining | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
    resume: bool = True,
    *,
    workers: int = 1,
    backend: str | None = None,
) -> Path:
    """Fit swarms, count, estimate the calibration and write it.

    Files in ``out``: ``calibration.json`` and ``rows.csv``, a row of :func:`fit_swarm` for each swarm, from which it
    goes on if ``resume``. The defaults of ``training`` give the shipped calibration. ``progress`` is called with the
    number of finished swarms and of all. The result does not depend on ``workers`` and ``backend``, see
    :func:`usnet_env.evaluation.run.map_tasks`.

    Raises:
        ArgumentError: an argument is refused, ``out`` can't be written, or it holds rows of other settings.
    """
    training = CalibrationTraining() if training is None else training
    folder = reserve_folder(Path(out))
    path = folder / "rows.csv"
    rows: list[dict[str, Any]] = []
    if resume and path.exists():
        found = pd.read_csv(path, keep_default_na=False)
        drawn = training.model_dump(exclude={"swarms"})
        if (found[list(drawn)] != drawn).any(axis=None):
            raise ArgumentError(f"out must hold no rows of other settings, got {quote(str(path))}.")
        rows = found.to_dict("records")
    left = range(len(rows), training.swarms)
    for row in map_tasks(partial(fit_swarm, training), left, workers=workers, backend=backend):
        rows.append(row)
        write_text(path, pd.DataFrame(rows).to_csv(index=False))
        progress(len(rows), training.swarms)
    table = pd.DataFrame(rows[: training.swarms])
    record = {
        "calibration": fit_calibration(table).model_dump(mode="json"),
        "training": {**training.model_dump(mode="json"), "command": "usnet train follow-mixture"},
        "metrics": {
            "uavs": int(table["living"].sum()),
            "heads": int(table["heads"].sum()),
            "swarms with followers": int(table["follows"].sum()),
            "exact": int(table["exact"].sum()),
            **_score(table),
        },
    }
    write_text(folder / "calibration.json", json.dumps(record, indent=2) + "\n")
    return folder / "calibration.json"
