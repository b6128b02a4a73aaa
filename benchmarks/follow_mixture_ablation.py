"""What every rule of follow-mixture is worth: each is switched off alone, on the same swarms. Resumable.

    OMP_NUM_THREADS=1 python benchmarks/follow_mixture_ablation.py --tier random --games 600
    OMP_NUM_THREADS=1 python benchmarks/follow_mixture_ablation.py --tier paper smooth --games 10 5
    python benchmarks/follow_mixture_ablation.py --list     # the switches

Swarms of the tier ``random`` are those of the calibration's grammar (``detectors.follow_mixture.train``), with another
seed; one window of each is fitted. All other tiers are those of ``follow_mixture.py``, beside ``large`` (more than 500
UAVs). Each game is played once with the whole detector, and again under each switch of ``ablation_switches.py``; of the
computations only those that the switch reaches are repeated (``partial_replay.py``).

One row of ``results/follow_mixture/ablation.csv`` is one game: of the whole detector (``switch`` empty), with the keys
of the switches whose code was reached and of those that changed an intermediate result; and of every switch under which
an answer differed. A switch without a row has the same answers as the whole detector.
"""

from __future__ import annotations

import argparse
import csv
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from ablation_switches import SWITCHES
from follow_mixture import Cell, cells, shifted_tracks
from numpy.typing import NDArray
from partial_replay import Replay, Run, Switch

from detectors.follow_mixture import FollowMixture
from detectors.follow_mixture.calibration import VERDICTS, Belief, Calibration, Curves, Rates, shipped_calibration
from detectors.follow_mixture.explanation import KINDS
from detectors.follow_mixture.train import CalibrationTraining, draw_swarm, draw_window, read_rows
from detectors.follow_mixture.train import _fitted_curve as fitted_curve
from usnet_env import Window
from usnet_env.envs import MultiClusterEnv, SingleClusterEnv
from usnet_env.evaluation.episode import episode_seeds
from usnet_env.objectives import multi_cluster_objective, single_cluster_objective

RESULTS = Path(__file__).parent / "results"
FILE = RESULTS / "follow_mixture" / "ablation.csv"
SEED = 16  # seeds below 1000 are for tuning
PACKAGE = "detectors.follow_mixture"
MODULES = (
    "calibration", "detector", "evidence", "explain", "explanation", "facility", "flock_evidence", "flock_heads",
    "flock_leads", "flock_search", "flocks", "gate", "history", "likelihood", "mixture", "mixture_evidence", "noise",
    "pair_evidence", "policy", "samples", "scale", "search", "strategy",
)  # fmt: skip
#: Pure functions that take long or are called again with the same arguments.
STORED = (
    "samples.samples_of", "samples.filled", "history.own_history", "evidence.gain_and_chance",
    "evidence.pairwise_gain", "evidence.whitened", "facility.locate_heads", "strategy.fit_strategy",
    "strategy.gain_matrix", "strategy.directions", "mixture.fit_mixture", "search.misfit", "search.climbed",
    "search.shortcut", "search.again", "search.within_reach", "search.explained_by_reach", "search.settled",
    "search.with_led", "search.climb_together", "search.explains", "pair_evidence.pair_evidence",
    "pair_evidence.plain_evidence", "pair_evidence.led_by", "pair_evidence.led_by_laws", "pair_evidence.joined",
    "pair_evidence.explained_by_pairs", "pair_evidence.fly_alone", "gate.gate_heads", "gate.gain_behind",
    "mixture_evidence.explained_by_mixture", "flocks.flocks_of", "flocks._merged", "noise.fit_spectra",
    "noise.smoothed_pasts", "flock_search.seen_spectra", "flock_search.flock_search", "flock_search.first_guesses",
    "flock_heads.watch_flocks", "flock_heads.shown", "flock_heads.each_by_itself", "flock_heads.in_company",
    "flock_heads.exact_gain",
    "flock_heads.fit_flocks", "flock_heads.shared_gain", "flock_heads.sobered", "flock_heads.heads_of_flocks",
    "flock_evidence.flock_gate", "flock_evidence.flock_posterior", "flock_evidence.explained_by_flocks",
    "flock_leads.leads_of_flocks", "flock_leads.responses", "flock_leads.fit_response", "flock_leads.climbed",
    "flock_leads.explained_by_leads", "explain.flown", "explain.by_flocks", "explain.at_once", "explain.by_everybody",
    "explain.missed_by_flocks",
)  # fmt: skip
COLUMNS = (
    "tier", "cell", "seed", "game", "list", "switch", "uavs", "heads", "J", "exact", "named", "missed_first",
    "false_first", "rounds", "reached", "changed", "seconds",
)  # fmt: skip
#: The grammar of the calibration, with smaller swarms: an answer for 150 UAVs takes ten times as long as for 50.
RANDOM = CalibrationTraining(most_uavs=60)
MOST_ROUNDS = 20  # a game that is not over then ends without a result
Mask = NDArray[np.bool_]


def large_cells() -> list[Cell]:
    """Swarms of more than 500 UAVs, for the rules that only these meet."""
    return [
        Cell("large", f"{f}-{mobility}-{decoys}", {
            "follow": f, "mobility": mobility, "head_jitter": mobility != "iid", "clusters": 12, "uavs": 520 + decoys,
            "decoys": decoys,
        })
        for f in ("f1", "f3", "f4", "f6", "f7")
        for mobility in ("iid", "gauss_markov")
        for decoys in (0, 160)
    ]  # fmt: skip


@dataclass(frozen=True)
class Played:
    """One game: the windows, the candidates of every round, the true heads, and what an objective makes of them."""

    windows: list[Window]
    fired: list[Mask]
    head: Mask
    over: bool
    reached: frozenset[str]
    changed: bool
    seconds: float


class Game:
    """One game that can be played again under a switch.

    Args:
        cell: what kind of game; the tier ``random`` has one.
        number: of the game.
    """

    def __init__(self, cell: Cell, number: int) -> None:
        self.cell, self.number, self.kind = cell, number, cell.kind
        self.swarm_seed, self.detector_seed = episode_seeds(SEED, number)
        self.name = cell.name
        self._window: Window | None = None
        if cell.tier == "random":
            rng = np.random.default_rng([SEED, number])
            config = draw_swarm(RANDOM, rng)
            self._window, self.head, later = draw_window(config, rng)
            self.name = _sort_of_swarm(config, later)
            self.kind = "window" if self.head.any() else "silence"

    def start(self) -> tuple[Any, Window]:
        """The environment (``None`` for a single window), and the first window; sets ``head``."""
        if self._window is not None:
            return None, self._window
        env = (SingleClusterEnv if self.kind == "P1" else MultiClusterEnv)(**self.cell.env)
        observation, _ = env.reset(seed=self.swarm_seed)
        self.head = env.swarm.head & (self.kind not in ("silence", "shifted"))
        window = Window.from_observation(observation)
        return env, shifted_tracks(window, self.detector_seed) if self.kind == "shifted" else window

    def detector(self) -> FollowMixture:
        """The detector as it is published for this kind of game, reset."""
        empty = self.kind in ("silence", "shifted")
        made = FollowMixture(policy="map" if empty else "cost", objective="P1" if self.kind == "P1" else "P2")
        made.reset(self.detector_seed)
        return made

    def play(self, run: Callable[[Callable[[], Any]], Run], known: Played | None = None) -> Played:
        """Play; windows of a known game are used as long as all candidates are the same."""
        detector, begun = self.detector(), time.perf_counter()
        env = None
        if known is None:
            env, window = self.start()
        else:
            window = known.windows[0]
        windows, fired, over, same = [window], list[Mask](), False, known is not None
        reached, changed = frozenset[str](), False
        while not over and len(fired) < MOST_ROUNDS:
            done = run(lambda window=window: detector.detect(window).candidates)
            fired.append(done.result)
            reached, changed = reached | done.reached, changed or done.changed
            if self.kind not in ("P2", "P1"):
                over = True
                break
            if same and known is not None:
                same = np.array_equal(done.result, known.fired[len(fired) - 1])
                if same and len(fired) == len(known.fired):
                    over = known.over
                    break
                if same:
                    window = known.windows[len(fired)]
                    windows.append(window)
                    continue
            if env is None:
                env, _ = self.start()
                for candidates in fired[:-1]:
                    env.step(candidates.astype(np.int8))
            observation, _, terminated, truncated, _ = env.step(fired[-1].astype(np.int8))
            over = terminated or truncated
            if not over:
                window = Window.from_observation(observation)
                windows.append(window)
        return Played(windows, fired, self.head, over, reached, changed, time.perf_counter() - begun)

    def row(self, played: Played | None, switch: str) -> dict[str, Any]:
        """What is written of a game; ``None`` for a switch under which the detector failed."""
        row: dict[str, Any] = dict.fromkeys(COLUMNS, "")
        row |= {"tier": self.cell.tier, "cell": self.name, "seed": SEED, "game": self.number, "switch": switch}
        row |= {"uavs": len(self.head), "heads": int(self.head.sum()), "exact": 0}
        if played is None:
            return row
        rounds, head = np.array(played.fired), self.head
        missed, false = int((head & ~rounds[0]).sum()), int((rounds[0] & ~head).sum())
        if self.kind == "P2":
            value = multi_cluster_objective(head, rounds)
        elif self.kind == "P1":
            value = float(single_cluster_objective(head, rounds[0]))
        elif self.kind == "window":  # the least J_m that this first round allows
            value = 1.0 + (missed > 0) + false / len(head)
        else:
            value = float(rounds[0].sum())
        row |= {"J": round(value, 5), "exact": int(not missed and not false), "named": int(rounds[0].sum())}
        row |= {"missed_first": missed, "false_first": false, "rounds": len(rounds)}
        return row | {"seconds": round(played.seconds, 3)}


def _sort_of_swarm(config: Any, later: bool) -> str:
    """A name of a random swarm: mobility, then what makes it hard."""
    marks = {
        "none": config.follow == "none",
        "bare": not config.head_jitter,
        "noise": config.position_noise > 0,
        "missed": config.miss_rate > 0,
        "decoys": config.decoys > 0,
        "short": config.observation_steps < 30,
        "later": later,
    }
    return "-".join([config.mobility, *(name for name, true in marks.items() if true)])


@cache
def pooled_calibrations() -> dict[str, Calibration]:
    """Calibrations from the committed rows: with one curve; with one rate of heads and one of unassigned UAVs."""
    rows = read_rows(RESULTS / "follow_mixture_calibration.csv.gz")
    shipped = shipped_calibration()
    curved, rated = {}, {}
    for name, whole in (("probability", False), ("given", True)):
        own: Belief = getattr(shipped, name)
        some = [row for row in rows if row["way"] in VERDICTS and (name == "probability" or row["follows"] == "1")]
        curve = fitted_curve(some, name, whole)
        curved[name] = Belief(rates=own.rates, curves=Curves(**dict.fromkeys(VERDICTS, curve)))
        counts = dict.fromkeys(KINDS, np.zeros(2))
        for row in rows:
            for entry in row["kinds"].split() if name == "probability" or row["follows"] == "1" else ():
                kind, uavs, heads = entry.split(":")
                counts[kind] = counts[kind] + (float(uavs), float(heads))
        pools = (("passed", "failed"), ("stray", "missing", "alone"), ("follower",))
        sums = {kind: sum(counts[one] for one in pool) for pool in pools for kind in pool}
        rates = {kind: float((heads + 0.06) / (uavs + 1.0)) for kind, (uavs, heads) in sums.items()}
        rated[name] = Belief(rates=Rates(**rates), curves=own.curves)
    return {"one_curve": Calibration(**curved), "one_rate": Calibration(**rated)}


def make_replay(switches: tuple[Switch, ...] = SWITCHES) -> Replay:
    """The detector with switches."""
    return Replay(PACKAGE, MODULES, switches, STORED, pooled_calibrations())


def measured(replay: Replay, game: Game, switches: tuple[Switch, ...]) -> list[dict[str, Any]]:
    """Play a game whole and under every switch; the row of the whole detector comes last."""
    replay.forget()
    whole = game.play(replay.run)
    rows, changed = [], []
    for switch in switches:
        if switch.key not in whole.reached:
            continue
        try:
            other = game.play(lambda call, key=switch.key: replay.run(call, key), whole)
        except (ArithmeticError, ValueError, IndexError, np.linalg.LinAlgError):
            rows.append(game.row(None, switch.key))
            changed.append(switch.key)
            continue
        differs = len(other.fired) != len(whole.fired) or any(
            not np.array_equal(one, two) for one, two in zip(other.fired, whole.fired, strict=True)
        )
        if differs:
            rows.append(game.row(other, switch.key))
        if other.changed or differs:
            changed.append(switch.key)
    replay.forget()
    keys = [switch.key for switch in switches]
    reached = " ".join(key for key in keys if key in whole.reached)
    return [*rows, game.row(whole, "") | {"reached": reached, "changed": " ".join(changed)}]


def cells_of(tier: str, parts: list[str] | None = None) -> list[Cell]:
    """The cells of a tier; only those whose names contain one of ``parts``, if there are any."""
    if tier == "random":
        return [Cell("random", "")]
    every = [cell for cell in [*cells(), *large_cells()] if cell.tier == tier]
    return [cell for cell in every if not parts or any(part in cell.name for part in parts)]


def games(tiers: dict[str, int], parts: list[str] | None = None) -> Iterator[Game]:
    """The games of some tiers, with the number of games of each cell; for each number, one game of every cell."""
    for tier, count in tiers.items():
        for number in range(count):
            for cell in cells_of(tier, parts):
                yield Game(cell, number)


def measure(path: Path, wanted: Iterator[Game], until: float, second: bool) -> None:
    """Play the games that the file lacks, and append their rows."""
    own = tuple(switch for switch in SWITCHES if switch.second == second)
    known: set[tuple[str, str, int]] = set()
    if path.exists():
        with path.open(newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
        known = {
            (row["tier"], row["cell"], int(row["game"]))
            for row in rows
            if not row["switch"] and (row["list"] == "second") == second
        }
    new = not path.exists()
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a", newline="", encoding="utf-8") as file, make_replay() as replay:
        writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
        if new:
            writer.writeheader()
        for game in wanted:
            if (game.cell.tier, game.name, game.number) in known:
                continue
            if time.time() > until:
                return
            which = "second" if second else "first"
            writer.writerows({**row, "list": which} for row in measured(replay, game, own))
            file.flush()


def parser() -> argparse.ArgumentParser:
    """The command line."""
    made = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    made.add_argument("--tier", nargs="*", default=["random"])
    made.add_argument(
        "--games", type=int, nargs="+", default=[10], help="of each cell: one number, or one for each tier"
    )
    made.add_argument("--cell", nargs="*", help="only cells whose names contain one of these")
    made.add_argument("--minutes", type=float, default=float("inf"), help="no game begins later than this")
    made.add_argument("--second", action="store_true", help="the switches of the second list, whose replays take long")
    made.add_argument("--out", type=Path, default=FILE)
    made.add_argument("--list", action="store_true", help="list the switches and play nothing")
    return made


def chosen(arguments: argparse.Namespace) -> dict[str, int]:
    """The tiers that the command line asks for, with the number of games of each cell."""
    counts = arguments.games * (len(arguments.tier) if len(arguments.games) == 1 else 1)
    return dict(zip(arguments.tier, counts, strict=True))


def main() -> None:
    """List the switches, or play."""
    arguments = parser().parse_args()
    if arguments.list:
        for switch in SWITCHES:
            print(f"{switch.key:18} {switch.what}")
        return
    until = time.time() + 60.0 * arguments.minutes
    measure(arguments.out, games(chosen(arguments), arguments.cell), until, arguments.second)


if __name__ == "__main__":
    main()
