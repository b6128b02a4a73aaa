"""What follow-mixture finds, cell by cell, beside lagged regression and the trivial policies. Resumable.

OMP_NUM_THREADS=1 python benchmarks/follow_mixture.py --tier paper --episodes 20 --detectors follow-mixture
python benchmarks/follow_mixture.py --list            # the cells
python benchmarks/follow_mixture.py --table           # only the table of the rows that are there
python benchmarks/follow_mixture.py --reliability     # head probabilities against what was so: reliability.{md,png}
python benchmarks/follow_mixture.py --policies        # J of policy='cost' and 'map' where both played an episode

Rows go to benchmarks/results/follow_mixture/<tier>.csv, one an episode, as they come; episodes that are there are not
played again. Swarm seeds come from --seed (7077 by default; below 1000 for tuning) and the episode's number.
"""

from __future__ import annotations

import argparse
import csv
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from follow_mixture_strategies import LOOKED_AT, OUT_OF_LIST, UNSEEN
from numpy.typing import NDArray

from usnet_env import Window
from usnet_env.drawing import new_figure
from usnet_env.envs import MultiClusterEnv, SingleClusterEnv
from usnet_env.evaluation.episode import episode_seeds
from usnet_env.evaluation.statistics import mean_interval, rate_interval
from usnet_env.files import atomic_write
from usnet_env.objectives import average_precision, multi_cluster_objective, single_cluster_objective
from usnet_env.plugins import detector_label, make_detector

if TYPE_CHECKING:
    from matplotlib.figure import Figure

RESULTS = Path(__file__).parent / "results" / "follow_mixture"
OURS = "follow-mixture"
PEERS = ("lagged-regression", "granger", "factions", "destroy-all", "random", "none")
SEED = 7077  # of the rows that are published: nothing was tuned on it, nor looked at before
PAPER = ("f1", "f2", "f3", "f4", "f5", "f6", "f7")
SMOOTH = ("gauss_markov", "smooth_turn", "local_waypoint")
LONG = {"clusters": 3, "uavs": 30, "observation_steps": 900}  # 30 samples a UAV: five autocorrelation times
#: Edges of the bins of probability: fine where a swarm has most of its UAVs.
EDGES = (0, 0.001, 0.003, 0.01, 0.03, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.97, 0.99, 1)
EVERY_MOBILITY = ("iid", "gauss_markov", "smooth_turn", "waypoint", "local_waypoint", "straight")


@dataclass(frozen=True)
class Cell:
    """One kind of episode.

    Args:
        tier: name of the group, and of the file.
        name: within the tier.
        env: arguments of the environment.
        kind: ``P2`` (a game), ``P1``, ``silence`` (nobody follows: nobody may be named) or ``shifted`` (every track
            moved in time by an amount of its own: nobody may be named).
        episodes: how many the contract asks for.
    """

    tier: str
    name: str
    env: dict[str, Any] = field(default_factory=dict)
    kind: str = "P2"
    episodes: int = 50


def cells() -> list[Cell]:
    found = [Cell("paper", f, {"follow": f}, episodes=300) for f in PAPER]
    sizes = ((2, 20), (3, 45), (5, 50), (8, 185), (10, 120), (20, 237))
    found += [Cell("sizes", f"{f}-M{m}-N{n}", {"follow": f, "clusters": m, "uavs": n}) for f in PAPER for m, n in sizes]
    for mobility in SMOOTH:
        found += [
            Cell("smooth", f"{f}-{mobility}", {"follow": f, "mobility": mobility, "head_jitter": True}) for f in PAPER
        ]
    for jitter in (True, False):
        name = "jitter" if jitter else "bare"
        found += [
            Cell("straight", f"{f}-{name}", {"follow": f, "mobility": "straight", "head_jitter": jitter}) for f in PAPER
        ]
    for steps in (8, 12, 20, 50):
        found += [Cell("short", f"{f}-T{steps}", {"follow": f, "observation_steps": steps}) for f in PAPER]
    for sigma in (0.1, 0.3, 0.5, 1.0):
        found += [Cell("noise", f"{f}-{sigma}", {"follow": f, "position_noise": sigma}) for f in PAPER]
    for sigma in (0.1, 0.3, 0.5):
        smooth = {"mobility": "gauss_markov", "head_jitter": True, "position_noise": sigma}
        found += [Cell("noise", f"{f}-gauss_markov-{sigma}", {"follow": f, **smooth}) for f in PAPER]
    for rate in (0.1, 0.3):
        found += [Cell("missed", f"{f}-{rate}", {"follow": f, "miss_rate": rate}) for f in PAPER]
    found += [Cell("sampled", f"{f}-2", {"follow": f, "sample_every": 2}, episodes=20) for f in PAPER]
    for mobility in EVERY_MOBILITY:
        for jitter in (True, False):
            env = {"mobility": mobility, "head_jitter": jitter}
            name = f"{mobility}-{'jitter' if jitter else 'bare'}"
            found.append(Cell("silence", f"none-{name}", {"follow": "none", **env}, "silence", 100))
        for f in PAPER:
            env = {"follow": f, "mobility": mobility, "head_jitter": True, **LONG}
            found.append(Cell("shifted", f"{f}-{mobility}", env, "shifted", 30))
    for decoys in (1, 3, 10):
        for mobility in ("iid", "gauss_markov"):
            env = {"mobility": mobility, "head_jitter": mobility != "iid", "decoys": decoys, "uavs": 82 + decoys}
            found += [Cell("decoys", f"{f}-{mobility}-{decoys}", {"follow": f, **env}) for f in PAPER]
    found += [
        Cell("P1", f"{f}-m{m}-d{d}", {"follow": f, "followers": m, "decoys": d}, "P1", 100)
        for f in PAPER
        for m, d in ((2, 1), (2, 0), (15, 1))
    ]
    found += [Cell("unlisted", f, {"follow": f}) for f in (*OUT_OF_LIST, *LOOKED_AT, *UNSEEN)]
    found += [
        Cell("unlisted", f"{f}-gauss_markov", {"follow": f, "mobility": "gauss_markov", "head_jitter": True})
        for f in (*OUT_OF_LIST, *LOOKED_AT, *UNSEEN)
    ]
    return found


COLUMNS = (
    "tier", "cell", "detector", "seed", "episode", "uavs", "heads", "J", "rounds", "exact", "named", "false_first",
    "missed_first", "decoys_named", "ap", "brier", "reliability", "seconds",
)  # fmt: skip


def shifted_tracks(window: Window, seed: int) -> Window:
    """Every UAV's velocities moved circularly by an amount of its own; tracks are flown anew from their start.

    Any two UAVs are moved by T_ob / N samples or more against each other: two fellows moved by less than the memory
    would be a follower and its head.
    """
    steps, uavs = window.observation_steps, window.uavs
    velocity = window.velocity.copy()
    for uav, place in enumerate(np.random.default_rng(seed).permutation(uavs)):
        velocity[:, uav] = np.roll(velocity[:, uav], place * (steps // uavs), axis=0)
    position = np.concatenate([window.position[:1], window.position[:1] + np.cumsum(velocity, axis=0)])
    return Window(position, velocity, window.seen, window.alive, window.round)


def binned(probability: NDArray[np.float64], head: NDArray[np.bool_]) -> str:
    """``bin:uavs:heads`` of every bin between :data:`EDGES` that is not empty, joined by spaces."""
    bins = np.digitize(probability, EDGES[1:-1])
    uavs, heads = (np.bincount(some, minlength=len(EDGES) - 1) for some in (bins, bins[head]))
    return " ".join(f"{place}:{uavs[place]}:{heads[place]}" for place in np.flatnonzero(uavs))


def play(cell: Cell, detector: Any, label: str, seed: int, episode: int) -> dict[str, Any]:
    """One episode; its row."""
    env = (SingleClusterEnv if cell.kind == "P1" else MultiClusterEnv)(**cell.env)
    swarm_seed, detector_seed = episode_seeds(seed, episode)
    observation, _ = env.reset(seed=swarm_seed)
    truth = env.swarm
    head = truth.head & (cell.kind not in ("silence", "shifted"))
    detector.reset(detector_seed)
    alive = truth.alive
    fired, over, first = [], False, None
    begun = time.perf_counter()
    while not over:
        window = Window.from_observation(observation)
        if cell.kind == "shifted":
            window = shifted_tracks(window, detector_seed)
        answer = detector.detect(window)
        first = first or answer
        fired.append(answer.candidates)
        over = cell.kind in ("silence", "shifted")
        if not over:
            observation, _, terminated, truncated, _ = env.step(answer.candidates.astype(np.int8))
            over = terminated or truncated
    seconds = (time.perf_counter() - begun) / len(fired)
    rounds = np.array(fired)
    if cell.kind == "P2":
        value = multi_cluster_objective(truth.head, rounds)
    elif cell.kind == "P1":
        value = float(single_cluster_objective(truth.head, rounds[0]))
    else:
        value = float(rounds[0].sum())
    probability = first.extras.get("probability")
    return {
        "tier": cell.tier,
        "cell": cell.name,
        "detector": label,
        "seed": seed,
        "episode": episode,
        "uavs": len(head),
        "heads": int(head.sum()),
        "J": round(value, 5),
        "rounds": len(fired),
        "exact": int(np.array_equal(rounds[0], head)),
        "named": int(rounds[0].sum()),
        "false_first": int((rounds[0] & ~head).sum()),
        "missed_first": int((head & ~rounds[0]).sum()),
        "decoys_named": int((rounds[0] & truth.decoy).sum()),
        "ap": round(average_precision(head, first.scores), 4),
        "brier": "" if probability is None else round(float(((probability - head) ** 2).mean()), 6),
        "reliability": "" if probability is None else binned(probability[alive], head[alive]),
        "seconds": round(seconds, 5),
    }


def rows_of(path: Path) -> list[dict[str, str]]:
    if not path.exists():
        return []
    with path.open(newline="", encoding="utf-8") as file:
        return [row for row in csv.DictReader(file) if row["seconds"]]  # a row cut off in writing lacks its end


def measure(wanted: list[Cell], detectors: list[str], episodes: int | None, seed: int, results: Path) -> None:
    """Play what is missing and append its rows."""
    results.mkdir(parents=True, exist_ok=True)
    for cell in wanted:
        path = results / f"{cell.tier}.csv"
        there = {(r["cell"], r["detector"], int(r["seed"]), int(r["episode"])) for r in rows_of(path)}
        new = not path.exists()
        if not new:
            with path.open(newline="", encoding="utf-8") as file:
                if next(csv.reader(file), None) != list(COLUMNS):
                    raise SystemExit(
                        f"{path.name} has other columns than are written now: measure into another folder."
                    )
        with path.open("a", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
            if new:
                writer.writeheader()
            for name in detectors:
                detector, label = make_detector(name), detector_label(name)
                for episode in range(cell.episodes if episodes is None else episodes):
                    if (cell.name, label, seed, episode) not in there:
                        writer.writerow(play(cell, detector, label, seed, episode))
                        file.flush()


def table(wanted: list[Cell], results: Path, seed: int) -> Iterator[str]:
    """One line a cell and detector, with 95 % intervals."""
    yield "| tier | cell | detector | n | exact (95 %) | mean J (95 %) | false | missed | decoys | AP | ms |"
    yield "| --- |" + " --- |" * 10
    for tier in dict.fromkeys(cell.tier for cell in wanted):
        rows = [row for row in rows_of(results / f"{tier}.csv") if int(row["seed"]) == seed]
        for cell in (cell for cell in wanted if cell.tier == tier):
            own = [row for row in rows if row["cell"] == cell.name]
            for label in dict.fromkeys(row["detector"] for row in own):
                some = [row for row in own if row["detector"] == label]
                exact = rate_interval([int(row["exact"]) for row in some])
                cost = mean_interval([float(row["J"]) for row in some])
                means = [
                    np.mean([float(row[name]) for row in some])
                    for name in ("false_first", "missed_first", "decoys_named", "ap")
                ]
                yield (
                    f"| {tier} | {cell.name} | {label} | {len(some)} "
                    f"| {exact.mean:.3f} ({exact.low:.3f}-{exact.high:.3f}) "
                    f"| {cost.mean:.3f} ({cost.low:.3f}-{cost.high:.3f}) | "
                    + " | ".join(f"{mean:.2f}" for mean in means)
                    + f" | {1e3 * np.median([float(row['seconds']) for row in some]):.0f} |"
                )


def policy_of(cell: Cell, label: str) -> str | None:
    """``"cost"`` or ``"map"``: what ours, with no other argument, played in a cell; ``None`` for anything else."""
    if label == OURS:
        return str(cell.detector.get("policy", "cost"))
    return {f"{OURS}(policy='{policy}')": policy for policy in ("cost", "map")}.get(label)


def policies(wanted: list[Cell], results: Path, seed: int) -> Iterator[str]:
    """Mean J of both policies in every cell of P2, over the episodes that both played, and the paired difference."""
    yield "| tier | cell | n | J, cost | J, map | map - cost (95 %) |"
    yield "| --- |" + " --- |" * 5
    for tier in dict.fromkeys(cell.tier for cell in wanted):
        rows = [row for row in rows_of(results / f"{tier}.csv") if int(row["seed"]) == seed]
        for cell in (cell for cell in wanted if cell.tier == tier and cell.kind == "P2"):
            played: dict[str, dict[int, float]] = {"cost": {}, "map": {}}
            for row in rows:
                policy = policy_of(cell, row["detector"]) if row["cell"] == cell.name else None
                if policy is not None:
                    played[policy][int(row["episode"])] = float(row["J"])
            both = sorted(played["cost"].keys() & played["map"].keys())
            if both:
                cost, best = (np.array([played[policy][episode] for episode in both]) for policy in ("cost", "map"))
                gap = mean_interval(best - cost)
                yield (
                    f"| {tier} | {cell.name} | {len(both)} | {cost.mean():.3f} | {best.mean():.3f} "
                    f"| {gap.mean:+.3f} ({gap.low:+.3f} to {gap.high:+.3f}) |"
                )


def scores(rows: Iterable[Mapping[str, str]], column: str) -> list[float]:
    return [float(row[column]) for row in rows]


def rate_of(rows: Sequence[Mapping[str, str]], kind: str) -> str:
    """Exact rounds (silent ones where nobody follows), with a 95 % interval."""
    column = "exact" if kind in ("P2", "P1") else "named"
    hits = [value > 0 for value in scores(rows, column)]
    rate = rate_interval(hits if column == "exact" else [not hit for hit in hits])
    return f"{100 * rate.mean:.1f} % ({100 * rate.low:.1f}-{100 * rate.high:.1f})"


def cost_of(rows: Sequence[Mapping[str, str]]) -> str:
    cost = mean_interval(scores(rows, "J"))
    return f"{cost.mean:.3f} ({cost.low:.3f}-{cost.high:.3f})"


def beside(wanted: list[Cell], results: Path, seed: int) -> Iterator[str]:
    """A line a cell: ours with 95 % intervals, and the mean J of the others, with n."""
    for tier in dict.fromkeys(cell.tier for cell in wanted):
        rows = [row for row in rows_of(results / f"{tier}.csv") if int(row["seed"]) == seed]
        others = [name for name in dict.fromkeys(row["detector"] for row in rows) if not name.startswith(OURS)]
        if not rows:
            continue
        kinds = {cell.kind for cell in wanted if cell.tier == tier}
        measure = "heads named" if kinds <= {"silence", "shifted"} else "J"
        yield f"\n**{tier}**; of others the mean {measure} (n)\n"
        lines = [f"| {' | '.join(['cell', 'n', 'right (95 %)', f'mean {measure} (95 %)', *others])} |"]
        lines.append("| --- |" + " --- |" * (3 + len(others)))
        for cell in (cell for cell in wanted if cell.tier == tier):
            own = [row for row in rows if row["cell"] == cell.name]
            mine = [row for row in own if row["detector"] == OURS]
            if not mine:
                continue
            line = [cell.name, str(len(mine)), rate_of(mine, cell.kind), cost_of(mine)]
            for name in others:
                theirs = scores((row for row in own if row["detector"] == name), "J")
                line.append(f"{np.mean(theirs):.2f} ({len(theirs)})" if theirs else "")
            lines.append(f"| {' | '.join(line)} |")
        yield "\n".join(lines)


@dataclass(frozen=True)
class Reliability:
    """First windows of a tier.

    Args:
        brier: of every window.
        uavs: ``(bins,)``.
        heads: ``(bins,)``, of these.
    """

    brier: list[float]
    uavs: NDArray[np.int64]
    heads: NDArray[np.int64]


def by_variant(wanted: list[Cell], results: Path, seed: int) -> Iterator[str]:
    """A line for the cells of a tier that differ in the strategy alone: f1 to f6, f7 and those out of list apart."""
    yield "| tier | variant | strategies | episodes | right (95 %) | mean J (95 %) | worst cell |"
    yield "| --- |" + " --- |" * 6
    groups: dict[tuple[str, str, str], list[Cell]] = {}
    for cell in wanted:
        follow, _, variant = cell.name.partition("-")
        strategies = "f1-f6" if follow in PAPER[:6] else follow if follow in PAPER else "out of list"
        groups.setdefault((cell.tier, variant, "none" if follow == "none" else strategies), []).append(cell)
    tiers = {tier: [r for r in rows_of(results / f"{tier}.csv") if int(r["seed"]) == seed] for tier, _, _ in groups}
    for (tier, variant, strategies), cells_there in groups.items():
        played = {
            cell.name: [row for row in tiers[tier] if row["cell"] == cell.name and row["detector"] == OURS]
            for cell in cells_there
        }
        played = {name: rows for name, rows in played.items() if rows}
        if played:
            every = [row for rows in played.values() for row in rows]
            worst, rows = max(played.items(), key=lambda one: np.mean(scores(one[1], "J")))
            yield (
                f"| {tier} | {variant} | {strategies} | {len(every)} | {rate_of(every, cells_there[0].kind)} "
                f"| {cost_of(every)} | {worst}: {np.mean(scores(rows, 'J')):.3f} |"
            )


def reliability(tiers: Sequence[str], results: Path, seed: int) -> dict[str, Reliability]:
    """Of every tier that has rows of ours, whatever policy was played: it does not change a first window."""
    found = {}
    for tier in tiers:
        counts = np.zeros((2, len(EDGES) - 1), np.int64)
        brier, known = [], set()
        for row in rows_of(results / f"{tier}.csv"):
            window = row["cell"], row["episode"]
            if row["detector"].partition("(")[0] == OURS and int(row["seed"]) == seed and window not in known:
                known.add(window)
                brier.append(float(row["brier"]))
                for entry in row["reliability"].split():
                    place, uavs, heads = map(int, entry.split(":"))
                    counts[:, place] += uavs, heads
        if brier:
            found[tier] = Reliability(brier, *counts)
    return found


def reliability_tables(found: Mapping[str, Reliability]) -> str:
    """Brier scores by tier, and heads among the UAVs of every bin."""
    lines = ["| tier | windows | UAVs | Brier (95 %) |", "| --- | --- | --- | --- |"]
    for tier, own in found.items():
        score = mean_interval(own.brier)
        interval = f"{score.mean:.4f} ({score.low:.4f}-{score.high:.4f})"
        lines.append(f"| {tier} | {len(own.brier)} | {own.uavs.sum()} | {interval} |")
    lines += ["", f"| probability | {' | '.join(found)} |", "| --- |" + " --- |" * len(found)]
    for place in range(len(EDGES) - 1):
        shares = [
            f"{own.heads[place] / own.uavs[place]:.4f} of {own.uavs[place]}" if own.uavs[place] else ""
            for own in found.values()
        ]
        lines.append(f"| {EDGES[place]}-{EDGES[place + 1]} | {' | '.join(shares)} |")
    return "\n".join([*lines, ""])


def reliability_figure(found: Mapping[str, Reliability]) -> Figure:
    """A panel a tier: in every bin the share of heads, on bars from edge to edge, which should cross it."""
    across = min(4, len(found))
    down = -(-len(found) // across)
    figure = new_figure(3.4 * across, 3.0 * down)
    panels = figure.subplots(down, across, squeeze=False, sharex=True, sharey=True).ravel()
    for axes in panels[len(found) :]:
        axes.set_visible(False)
    bins = np.arange(len(EDGES) - 1)
    low, high = np.array(EDGES[:-1], float), np.array(EDGES[1:], float)
    for axes, (tier, own) in zip(panels, found.items(), strict=False):
        some = own.uavs > 0
        share = own.heads[some] / own.uavs[some]
        axes.bar(bins, high - low, bottom=low, width=0.9, color="#cccccc", label="probability")
        axes.scatter(
            bins[some], share, s=6 * np.log10(1 + own.uavs[some]) ** 2, color="#0072b2", label="share of heads"
        )
        axes.set_yscale("symlog", linthresh=1e-3)
        axes.set_ylim(0, 1.3)
        axes.set_xticks(bins[::3], [f"{edge}" for edge in EDGES[:-1:3]], fontsize=7)
        axes.set_title(f"{tier}, {len(own.brier)} windows", fontsize=9)
        axes.tick_params(labelbottom=True)  # of panels above none as well
        axes.grid(alpha=0.3)
    panels[0].legend(fontsize=7)
    figure.supxlabel("probability of being a head, from", fontsize=9)
    figure.supylabel("share of heads", fontsize=9)
    figure.tight_layout()
    return figure


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tier", nargs="*", help="only these tiers")
    parser.add_argument("--cell", nargs="*", help="only cells whose names contain one of these")
    parser.add_argument("--episodes", type=int, help="a cell; by default what the contract asks for")
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--detectors", nargs="*", default=[OURS, *PEERS])
    parser.add_argument("--results", type=Path, default=RESULTS)
    parser.add_argument("--table", action="store_true", help="play nothing")
    parser.add_argument(
        "--summary",
        action="store_true",
        help="play nothing; write the tables",
    )
    parser.add_argument("--reliability", action="store_true", help="play nothing; write reliability.md and .png")
    parser.add_argument("--policies", action="store_true", help="play nothing; compare both policies")
    parser.add_argument("--list", action="store_true", help="list the cells")
    asked = parser.parse_args()
    wanted = [
        cell
        for cell in cells()
        if (not asked.tier or cell.tier in asked.tier)
        and (not asked.cell or any(part in cell.name for part in asked.cell))
    ]
    if asked.list:
        for cell in wanted:
            print(cell.tier, cell.name, cell.kind, cell.episodes, cell.env)
        return
    if asked.reliability:
        found = reliability(list(dict.fromkeys(cell.tier for cell in wanted)), asked.results, asked.seed)
        if not found:
            raise SystemExit("There are no rows yet: play some cells first.")
        with atomic_write(asked.results / "reliability.md") as aside:
            aside.write_text(reliability_tables(found), encoding="utf-8")
        with atomic_write(asked.results / "reliability.png") as aside:
            reliability_figure(found).savefig(aside, format="png", dpi=100)
        print(reliability_tables(found))
        return
    if asked.summary:
        out_of_list = [cell for cell in wanted if cell.tier == "unlisted"]
        pages = (
            ("cells.md", beside, wanted),
            ("tiers.md", by_variant, wanted),
            ("unlisted.md", beside, out_of_list),
            ("policies.md", policies, wanted),
        )
        for name, lines, some in pages:
            with atomic_write(asked.results / name) as aside:
                aside.write_text("\n".join([*lines(some, asked.results, asked.seed), ""]).lstrip(), encoding="utf-8")
        return
    if asked.policies:
        print("\n".join(policies(wanted, asked.results, asked.seed)))
        return
    if not asked.table:
        measure(wanted, asked.detectors, asked.episodes, asked.seed, asked.results)
    print("\n".join(table(wanted, asked.results, asked.seed)))


if __name__ == "__main__":
    main()
