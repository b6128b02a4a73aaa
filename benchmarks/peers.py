"""This program draws systems of other papers. A detector must find who influences whom in them.

    OMP_NUM_THREADS=1 python benchmarks/peers.py --runs 50 --rows out/peers.csv
    python -m venv out/tigramite && out/tigramite/bin/pip install tigramite numba
    python benchmarks/peers.py --detector pcmci+ --tigramite out/tigramite/bin/python
    python benchmarks/peers.py --draw                                       # plays nothing: the table of the rows

A run is one draw of a system, observed once. Rows have AUROC and AUPRC of its directed edges, without the diagonal and
from ``Detection.attention``, and whether the highest score is that of an influencer. The rows
`straightest` and `farthest` know nothing of pairs. A suite in which they do well doesn't test influence.
`forces` knows that accelerations are linear in positions, as springs are; `var-weak-ridge` is a vector autoregression.

* springs: particles in a box; half of the ordered pairs have a spring that pulls one of them (Kipf et al. 2018), and an
  influencer pulls all (Löwe et al. 2022). Others pull it back; in ``-unpulled`` they don't, so that it flies straight
  and its own track gives it away; in ``-unseen`` it isn't observed.
* structinfer: the same springs on directed graphs, random ones and growing ones, 15 particles, 49 steps (Wang et al.
  2024); the 11 graph families of the paper are not drawn.
* garland: flocks with zones, in which an order of ranks, a preferred course or places that one UAV knows lead the
  others (after Garland et al. 2018; the zones are those of Couzin et al. 2002).
* causal-dynamics: chaotic systems mixed along a growing acyclic graph, at once and with a lag (Herdeanu et al. 2025):
  ours has Lorenz and Rössler systems at the roots. A row's series are 300 steps.
"""

from __future__ import annotations

import subprocess
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np
import pandas as pd
from paper.shared import Game, make_parser, run_missing
from pivot import across, mean, pivot
from scipy.integrate import solve_ivp
from sklearn.metrics import average_precision_score, roc_auc_score

from usnet_env import Window, make_detector
from usnet_env.config import ArgumentError
from usnet_env.detection import ask

DETECTORS = (
    "random", "reader(policy='map')", "reader(policy='map', weights='blind')",
    "reader(policy='map', weights='untrained')", "directional-delays", "lagged-network", "net-lag-regression",
    "transfer-entropy", "mflica", "flica", "granger", "lagged-correlation", "factions", "var-weak-ridge", "forces",
    "pcmci+", "straightest", "farthest",
)  # fmt: skip
#: AUROC and AUPRC as the authors of CausalDynamics report them; their graphs and systems are other ones than ours.
PUBLISHED = {
    "causal-dynamics": "TSCI .69/.36, PCMCI+ .68/.27, FPCMCI .67/.24, DYNOTEARS .66/.32, VarLiNGAM .57/.18",
    "causal-dynamics-lag": "at most .55/.23",
}
Drawn = tuple[np.ndarray, np.ndarray, np.ndarray]  # (T + 1, N, d) positions, (N, N) bool: j acts on i, (N,) influencers


def draw_springs(rng: np.random.Generator, edges: np.ndarray, steps: int) -> np.ndarray:
    """Places ``(T + 1, N, 2)`` of particles in a box of ±5 with the force 0.1 (p_j - p_i), a sample each 0.1 s."""
    uavs, dt, every, box = len(edges), 0.001, 100, 5.0
    position, course = 0.5 * rng.standard_normal((uavs, 2)), rng.standard_normal((uavs, 2))
    speed = 0.5 * course / np.linalg.norm(course, axis=1, keepdims=True)
    pull, positions = 0.1 * edges, []
    for t in range(steps * every + 1):
        if t % every == 0:
            positions.append(position)
        speed = speed + dt * (pull @ position - pull.sum(axis=1, keepdims=True) * position)
        position = position + dt * speed
        speed = np.where(np.abs(position) > box, -np.sign(position) * np.abs(speed), speed)
        position = np.where(np.abs(position) > box, 2 * box * np.sign(position) - position, position)
    return np.stack(positions)


def draw_influencer(rng: np.random.Generator, uavs: int, pulled: bool = True, unseen: bool = False) -> Drawn:
    """Springs among half of the pairs, and an influencer, which may be free of the others' pull, or unseen."""
    count = uavs + unseen
    edges = (rng.random((count, count)) < 0.5) & ~np.eye(count, dtype=bool)
    edges[:-1, -1], edges[-1] = True, edges[-1] & pulled
    order = rng.permutation(uavs if unseen else count)
    position = draw_springs(rng, edges.astype(float), 99)
    return position[:, order], edges[np.ix_(order, order)], order == count - 1


def grow_graph(rng: np.random.Generator, uavs: int) -> np.ndarray:
    """Each node but the first gets an edge from an earlier one, drawn by the number of its edges."""
    edges = np.zeros((uavs, uavs), bool)
    for i in range(1, uavs):
        weight = 1.0 + edges[:i, :i].sum(axis=0)
        edges[i, rng.choice(i, p=weight / weight.sum())] = True
    return edges


def draw_structure(rng: np.random.Generator, grown: bool) -> Drawn:
    """Springs on a directed graph of 15 particles."""
    edges = grow_graph(rng, 15) if grown else (rng.random((15, 15)) < 0.15) & ~np.eye(15, dtype=bool)
    order = rng.permutation(15)
    edges = edges[np.ix_(order, order)]
    return draw_springs(rng, edges.astype(float), 49), edges, edges.any(axis=0) & ~edges.any(axis=1)


def draw_flock(rng: np.random.Generator, kind: str, uavs: int = 10, steps: int = 100) -> Drawn:
    """A flock with zones of repulsion (1), alignment and attraction (20), led by ranks, by a course or by positions."""
    order, position = rng.permutation(uavs), rng.uniform(0, 6, (uavs, 2))
    course, own_course = rng.standard_normal((2, uavs, 2))
    links = order[None] < order[:, None] if kind == "ranks" else ~np.eye(uavs, dtype=bool)
    leads, target, positions = order == 0, rng.uniform(-30, 30, 2), []
    for _ in range(50 + steps + 1):
        positions.append(position)
        gap = position[None] - position[:, None]
        distance = np.linalg.norm(gap, axis=2, keepdims=True) + np.eye(uavs)[..., None]
        is_close = (distance < 1.0) & (distance > 0) & ~np.eye(uavs, dtype=bool)[..., None]
        is_mate = links[..., None] & (distance < 20)
        repulsion, attraction = -(is_close * gap / distance).sum(axis=1), 0.5 * gap / distance
        social = (is_mate * (attraction + course / np.linalg.norm(course, axis=1, keepdims=True))).sum(axis=1)
        social /= np.maximum(is_mate.sum(axis=1), 1)
        own_course = own_course + 0.3 * rng.standard_normal((uavs, 2)) - 0.05 * own_course
        aim = target - position if kind == "places" else own_course
        if kind == "places" and np.linalg.norm(target - position[leads]) < 3:
            target = position[leads][0] + rng.uniform(-30, 30, 2)
        goal = aim / np.maximum(np.linalg.norm(aim, axis=1, keepdims=True), 1e-9)
        pull = (
            np.where(is_close.any(axis=1), repulsion, social)
            + (1.0 if kind == "ranks" else 0.7) * goal * leads[:, None]
        )
        pull += 0.1 * rng.standard_normal((uavs, 2))
        mixed = 0.5 * course + 0.5 * pull / np.maximum(np.linalg.norm(pull, axis=1, keepdims=True), 1e-9)
        course = mixed / np.maximum(np.linalg.norm(mixed, axis=1, keepdims=True), 1e-9)
        position = position + 0.3 * course
    return np.stack(positions[50:]), links, leads


def fly_chaos(rng: np.random.Generator, steps: int) -> np.ndarray:
    """A Lorenz or Rössler system ``(T, 3)`` from a random state, a sample each 0.02 or 0.1, of variance 1."""

    def flow(_: float, s: np.ndarray) -> list[float]:
        x, y, z = s
        lorenz = [10 * (y - x), x * (28 - z) - y, x * y - 8 / 3 * z]
        return lorenz if dt == 0.02 else [-y - z, x + 0.2 * y, 0.2 + z * (x - 5.7)]

    dt = rng.choice([0.02, 0.1])
    times = dt * np.arange(1000, 1000 + steps)
    series = solve_ivp(flow, (0, times[-1]), rng.standard_normal(3), t_eval=times, rtol=1e-7).y.T
    return (series - series.mean(axis=0)) / series.std(axis=0)


def draw_chaos(rng: np.random.Generator, lag: int, uavs: int = 5, steps: int = 300) -> Drawn:
    """Chaotic roots and mixtures of them along a growing graph; one edge in ten more has a lag."""
    direct, lagged = grow_graph(rng, uavs), np.zeros((uavs, uavs), bool)
    if lag:
        lagged = np.tril(rng.random((uavs, uavs)) < 0.1, -1) & ~direct
    position = np.zeros((steps + 1 + lag, uavs, 3))
    for i in range(uavs):
        if not (direct | lagged)[i].any():
            position[:, i] = fly_chaos(rng, len(position))
        for j in np.flatnonzero((direct | lagged)[i]):
            mixed = position[:, j] @ rng.normal(0, 3**-0.5, (3, 3)) + rng.normal(0, 0.1, 3)
            position[:, i] += np.roll(mixed, lag, axis=0) if lagged[i, j] else mixed
    order, edges = rng.permutation(uavs), direct | lagged
    edges, position = edges[np.ix_(order, order)], position[lag:, order]
    return position, edges, edges.any(axis=0) & ~edges.any(axis=1)


SUITES: dict[str, Callable[[np.random.Generator], Drawn]] = {
    **{f"springs-{uavs}": partial(draw_influencer, uavs=uavs) for uavs in (5, 10)},
    **{f"springs-{uavs}-unpulled": partial(draw_influencer, uavs=uavs, pulled=False) for uavs in (5, 10)},
    **{f"springs-{uavs}-unseen": partial(draw_influencer, uavs=uavs, unseen=True) for uavs in (5, 10)},
    "structinfer-random": partial(draw_structure, grown=False),
    "structinfer-grown": partial(draw_structure, grown=True),
    **{f"garland-{kind}": partial(draw_flock, kind=kind) for kind in ("ranks", "course", "places")},
    "causal-dynamics": partial(draw_chaos, lag=0),
    "causal-dynamics-lag": partial(draw_chaos, lag=10),
}
# Runs in the Python that has tigramite: reads positions of all runs, writes the strength of each link to i from j.
PCMCI = """
import sys, numpy as np
from tigramite import data_processing as pp
from tigramite.pcmci import PCMCI
from tigramite.independence_tests.parcorr_mult import ParCorrMult
runs, found = np.load(sys.argv[1]), []
for position in runs:
    steps, uavs, axes = position.shape
    groups = {i: [(axes * i + k, 0) for k in range(axes)] for i in range(uavs)}
    frame = pp.DataFrame(position.reshape(steps, -1), vector_vars=groups)
    search = PCMCI(frame, cond_ind_test=ParCorrMult(), verbosity=0)
    got = search.run_pcmciplus(tau_max=2, pc_alpha=0.05, max_conds_dim=2)
    directed = np.isin(got["graph"], ["-->", "o-o", "x-x"])
    found.append((np.abs(got["val_matrix"]) + directed).max(axis=2).T)
np.save(sys.argv[2], found)
"""


def run_pcmci(runs: np.ndarray, python: Path | None) -> np.ndarray:
    """Strengths ``(R, N, N)`` of links by PCMCI+ (Runge 2020), of positions ``(R, T + 1, N, d)``."""
    if python is None or not python.exists():
        raise ArgumentError(f"tigramite must be a Python that has tigramite, for the detector pcmci+, got {python}.")
    with tempfile.TemporaryDirectory() as folder:
        positions, links = Path(folder) / "runs.npy", Path(folder) / "found.npy"
        np.save(positions, runs)
        subprocess.run([str(python), "-c", PCMCI, str(positions), str(links)], check=True, capture_output=True)
        return np.load(links)


def fit_var(position: np.ndarray, ridge: float = 1e-9, lags: int = 2) -> np.ndarray:
    """Strengths ``(N, N)`` of links: the norm of the coefficients of j in the next position of i, by ridge."""
    steps, uavs, axes = position.shape
    flat = ((position - position.mean(axis=0)) / position.std(axis=0)).reshape(steps, -1)
    past = np.concatenate([flat[lags - 1 - k : steps - 1 - k] for k in range(lags)], axis=1)
    square = past.T @ past + ridge * len(past) * np.eye(past.shape[1])
    weights = np.linalg.solve(square, past.T @ flat[lags:]).reshape(lags, uavs, axes, uavs, axes)
    return np.sqrt(np.square(weights).sum(axis=(0, 2, 4))).T


def fit_forces(position: np.ndarray) -> np.ndarray:
    """Strengths ``(N, N)`` of links: how much the way to j explains i's acceleration; kicks of walls are left out."""
    uavs, speed = position.shape[1], np.diff(position, axis=0)
    accelerations, strengths = np.diff(speed, axis=0), np.zeros((uavs, uavs))
    for i in range(uavs):
        offsets = np.delete(position[1:-1] - position[1:-1, i : i + 1], i, axis=1).swapaxes(1, 2).reshape(-1, uavs - 1)
        inputs, acceleration = np.column_stack([offsets, speed[:-1, i].ravel()]), accelerations[:, i].ravel()
        is_smooth = np.abs(acceleration) < 8 * np.median(np.abs(acceleration)) + 1e-12
        weights = np.linalg.lstsq(inputs[is_smooth], acceleration[is_smooth], rcond=None)[0][:-1]
        strengths[i, np.arange(uavs) != i] = np.abs(weights)
    return strengths


RULES: dict[str, Callable[[np.ndarray], np.ndarray]] = {  # scores of positions, one track or one instant at a time
    "straightest": lambda position: -np.square(np.diff(position, n=2, axis=0)).sum(axis=2).mean(axis=0),
    "farthest": lambda position: np.linalg.norm(position - position.mean(axis=1, keepdims=True), axis=2).mean(axis=0),
}
FITS: dict[str, Callable[[np.ndarray], np.ndarray]] = {"var-weak-ridge": fit_var, "forces": fit_forces}


def find_links(
    name: str, runs: list[Drawn], seed: int, python: Path | None
) -> list[tuple[np.ndarray, np.ndarray, bool]]:
    """Of each run, strengths ``(N, N)`` of links to i from j, scores ``(N,)``, and whether any UAV is named."""
    positions = np.stack([position for position, _, _ in runs])
    if name in RULES:
        return [(np.full(edges.shape, np.nan), RULES[name](position), True) for position, edges, _ in runs]
    if name in FITS or name == "pcmci+":
        links = map(FITS[name], positions) if name in FITS else run_pcmci(positions, python)
        off_diagonal = [values * ~np.eye(len(values), dtype=bool) for values in links]
        return [(values, values.sum(axis=0) - values.sum(axis=1), True) for values in off_diagonal]
    answers = []
    for number, (position, _, _) in enumerate(runs):
        detector, padded = make_detector(name), np.pad(position, ((0, 0), (0, 0), (0, 3 - position.shape[2])))
        detector.reset(seed + number)
        seen = np.ones(padded.shape[:2], bool)
        answer, _ = ask(detector, Window(padded, np.diff(padded, axis=0), seen, seen[0], step=1.0))
        links = answer.attention
        if links is None:
            leader = answer.leader if answer.leader is not None else np.full(len(seen[0]), -1)
            links = leader[:, None] == np.arange(len(leader))
        answers.append((np.asarray(links, float), answer.scores, bool(answer.candidates.any())))
    return answers


def play(game: Game, seed: int, python: Path | None) -> list[dict[str, Any]]:
    """Let a detector answer all runs of a suite."""
    number = crc32(game["suite"].encode())
    runs = [SUITES[game["suite"]](np.random.default_rng([seed, number, k])) for k in range(game["runs"])]
    rows = []
    for k, (links, scores, named) in enumerate(find_links(game["detector"], runs, seed, python)):
        _, edges, leads = runs[k]
        is_pair = ~np.eye(len(edges), dtype=bool)
        truth, strength, best = edges[is_pair], links[is_pair], scores == scores.max()
        row = {"run": k, "auroc": np.nan, "auprc": np.nan, "top": np.nan, "chance": np.nan, "named": int(named)}
        if 0 < truth.mean() < 1 and np.isfinite(strength).all():
            row |= {"auroc": roc_auc_score(truth, strength), "auprc": average_precision_score(truth, strength)}
        if leads.any():
            row |= {"top": leads[best].mean(), "chance": leads.mean()}
        rows.append(game | row)
    return rows


def report(rows: pd.DataFrame) -> str:
    """A line for each suite: the pairs that every detector finds, and the influencers; and what others published."""
    names, suite = list(dict.fromkeys(rows.detector)), {"suite": "suite"}

    def find_pairs(part: pd.DataFrame) -> str:
        return f"{part.auroc.mean():.2f}/{part.auprc.mean():.2f}".replace("nan/nan", "–")

    pairs = across("detector", names, find_pairs, "`{}`")
    top = across("detector", names, mean("top", group="run"), "`{}`") | {"chance": mean("chance", group="run")}
    published = (f"Published, AUROC/AUPRC, {suite}: {text}." for suite, text in PUBLISHED.items())
    tables = pivot(rows[rows.auroc.notna()], suite, pairs), pivot(rows[rows.top.notna()], suite, top)
    return "\n\n".join(["AUROC/AUPRC of the pairs:", tables[0], "`top`:", tables[1], *published])


def main(argv: list[str] | None = None) -> None:
    parser = make_parser(__doc__, Path("out/peers.csv"))
    parser.add_argument("--suite", nargs="+", choices=list(SUITES), default=list(SUITES))
    parser.add_argument("--detector", nargs="+", default=list(DETECTORS))
    parser.add_argument("--runs", type=int, default=50)
    parser.add_argument("--tigramite", type=Path, help="a Python that has tigramite")
    options = parser.parse_args(argv)
    games = [
        {"suite": suite, "detector": name, "runs": options.runs} for suite in options.suite for name in options.detector
    ]
    print(report(run_missing(options, games, partial(play, seed=options.seed, python=options.tigramite))))


if __name__ == "__main__":
    main()
