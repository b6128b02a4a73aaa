"""What the reader owes to its prior and its features, and whether its probabilities are right.

    python benchmarks/reader.py families --workers 2       # a family left out of a short training, one after another
    python benchmarks/reader.py ablation                   # a group of features without information
    python benchmarks/reader.py calibration                # of the shipped weights, in suites and families

Trainings are kept in the folder --readers and rows in the folder --rows, and the same command goes on where it
stopped. A source is a cell of a suite, of which the first round is read, or a family of the prior. A row is a window
and a tenth of the range of p(head), with the number of its UAVs, the sum of their p and the number of their heads.
"""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Iterable
from functools import partial
from importlib.resources import files
from itertools import product
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np
import pandas as pd
from paper import shared
from pivot import CellFormatter, across, pivot, rate, size
from scipy import special
from sklearn.metrics import roc_auc_score

from detectors.reader.features import CONTEXT_GROUPS, PAIR_GROUPS, UAV_GROUPS, make_features
from detectors.reader.forward import load_reader, predict
from detectors.reader.prior import FAMILIES, draw_examples
from usnet_env import Window
from usnet_env.evaluation import list_suites, load_suite
from usnet_env.progress import progress_bar

STUDIES = ("calibration", "families", "ablation")
KEYS = ["reader", "dropped", "source", "episode"]
SUITES = ("field-v2", "controls-v2", "sensing-v2")
KINDS = {"pair": PAIR_GROUPS, "uav": UAV_GROUPS, "context": CONTEXT_GROUPS}
GROUPS = {name: (kind, part) for kind, groups in KINDS.items() for name, part in groups.items()}
NONE, SHIPPED = "nothing", "shipped"  # no group is dropped; the weights of the package
CONFIDENCES = (0.0, 0.2, 0.4, 0.6, 0.8, 0.95, 1.0)
#: Sets of windows of the reliability curve: of laws that the prior has, and of laws that it hasn't.
LAWS = {"in the prior": ("prior", *SUITES), "not in the prior": ("open", "open-second")}


def find_weights(readers: Path, label: str) -> Path:
    """The weights file of a training, or of the package."""
    data = Path(str(files("detectors.reader"))) / "data"
    return (data if label == SHIPPED else readers / label) / "reader.safetensors"


def ensure_training(options: Namespace, label: str, without: tuple[str, ...] = ()) -> None:
    """Train a reader without some families, unless its weights are there."""
    path = find_weights(options.readers, label)
    if path.exists() or options.draw:
        return
    from detectors.reader.train import ReaderTraining, train_reader  # it needs PyTorch

    settings = ReaderTraining(shards=options.shards, device=options.device, seed=options.seed, without=without)
    with progress_bar(label) as progress:
        train_reader(path.parent, settings, progress, workers=options.workers)


def draw_window(source: str, episode: int, seed: int) -> tuple[Window, np.ndarray]:
    """A window of a source and its heads ``(N,)``."""
    rng = np.random.default_rng([seed, crc32(source.encode()), episode])
    suite, _, name = source.partition("/")
    if suite != "prior":
        env = shared.open_cell(suite, name)
        observation, _ = env.reset(seed=int(rng.integers(2**63)))
        return Window.from_observation(observation), env.swarm.head
    position, velocity, seen, head = (array[0] for array in draw_examples(rng, 1, family=name)[:4])
    return Window(position, velocity, seen, np.ones(len(head), bool)), head


def read_window(path: Path, window: Window, dropped: str) -> tuple[np.ndarray, float]:
    """``(N,)`` p(head), and p(no UAV leads); a group of features that is dropped has its mean in the training."""
    flying = np.flatnonzero(window.velocity_seen.any(axis=0))
    features = make_features(window.position[:, flying], window.velocity[:, flying], window.seen[:, flying])
    weights = shared.cached(load_reader, str(path))
    if dropped != NONE:
        kind, part = GROUPS[dropped]
        getattr(features, kind)[..., part] = weights[f"{kind}_mean"][part]
    answer, p = predict(weights, features), np.zeros(window.uavs)
    p[flying] = special.expit(answer.head.astype(float))
    return p, float(special.expit(answer.silent))


def play(game: shared.Game, readers: Path, seed: int) -> list[dict[str, Any]]:
    """Read one window."""
    window, head = draw_window(game["source"], game["episode"], seed)
    p, p_no_leader = read_window(find_weights(readers, game["reader"]), window, game["dropped"])
    row = game | {
        "exact": int(((p > 0.5) == head).all()),
        "confidence": np.maximum(p, 1 - p).prod(),
        "silent": p_no_leader,
    }
    row["leads"] = "some UAV" if head.any() else "no UAV"
    bins = pd.DataFrame({"uavs": 1, "p": p, "heads": head.astype(int)}).groupby(np.minimum(10 * p, 9).astype(int)).sum()
    return [{**row, "bin": k, **sums} for k, sums in bins.to_dict("index").items()]


def list_cells(suites: Iterable[str] = SUITES, family: str = "") -> list[str]:
    """The cells of suites, or those with the name of a family as a part of their name."""
    part = family.removeprefix("fault:")
    names = [(suite, cell) for suite in suites for cell in load_suite(suite).cells]
    return [f"{suite}/{cell}" for suite, cell in names if not part or part in cell.split("-")]


def choose_windows(options: Namespace) -> Iterable[tuple[str, str, str]]:
    """The reader, the dropped group and the source of each window of a study, after the trainings that it needs."""
    if options.study == "families":
        ensure_training(options, "all")
        yield from product(["all"], [NONE], list_cells(["paper"]))  # f1 to f7 are in no prior
        for family in options.names or [name for name in FAMILIES if name != "field"]:
            ensure_training(options, f"without {family}", without=(family,))
            yield from product(["all", f"without {family}"], [NONE], [f"prior/{family}", *list_cells(family=family)])
    elif options.study == "ablation":
        yield from product([SHIPPED], [NONE, *(options.names or GROUPS)], list_cells())
    else:
        cells = list_cells(["paper", *SUITES, "open", "open-second", "limit"])
        yield from product([SHIPPED], [NONE], [*cells, *(f"prior/{family}" for family in FAMILIES)])


def measure_calibration(rows: pd.DataFrame) -> str:
    """The expected calibration error of p(head)."""
    sums = rows.groupby("bin")[["uavs", "p", "heads"]].sum()
    return f"{(sums.p - sums.heads).abs().sum() / max(sums.uavs.sum(), 1):.4f}"


def measure_reliability(rows: pd.DataFrame) -> str:
    """The mean of p(head), the share of heads, and the number of UAVs."""
    uavs, p, heads = rows[["uavs", "p", "heads"]].sum()
    return f"{p / uavs:.3f}; {heads / uavs:.3f}; {uavs:,.0f}" if uavs else "–"


def draw_reliability(rows: pd.DataFrame, path: Path) -> None:
    """Draw the share of heads among UAVs with about the same p(head); intervals are those over sources."""
    figure, grid = shared.panels(5.2, 4.4)
    axes = grid[0, 0]
    axes.plot([0, 1], [0, 1], color="#888888", lw=1, label="right probabilities")
    for number, (label, sets) in enumerate(LAWS.items()):
        sources = rows[rows.set.isin(sets)].groupby(["bin", "source"])[["uavs", "p", "heads"]].sum()
        points = np.array([find_reliability(part) for _, part in sources.groupby("bin")])
        x, y, low, high = points.T
        style = {"color": shared.COLORS[number], "marker": shared.MARKERS[number], "ms": 5, "lw": 1.4}
        axes.errorbar(x, y, [y - low, high - y], label=f"laws {label}", **style)
    axes.set(xlabel="mean p(head)", ylabel="share of heads", xlim=(0, 1), ylim=(0, 1))
    caption = "Reader, shipped weights; bars: 95 % intervals over families, cells or laws"
    shared.save_figure(figure, path, "Are its probabilities right?", caption)


def find_reliability(sources: pd.DataFrame, draws: int = 1000) -> tuple[float, float, float, float]:
    """The mean p(head) and the share of heads of one tenth with its 95 % interval, by drawing sources anew."""
    sums = sources[["uavs", "p", "heads"]].to_numpy(float)
    samples = np.random.default_rng(0).integers(len(sums), size=(draws, len(sums)))
    uavs, _, heads = sums[samples].sum(axis=1).T
    low, high = np.quantile(heads / uavs, (0.025, 0.975))
    return sums[:, 1].sum() / sums[:, 0].sum(), sums[:, 2].sum() / sums[:, 0].sum(), low, high


def measure_doubt(windows: pd.DataFrame) -> str:
    """The AUROC of 1 - confidence for windows that are not exact."""
    errors = 1 - windows.exact
    return "–" if errors.nunique() < 2 else f"{roc_auc_score(errors, 1 - windows.confidence):.3f}"


def format_confidence(windows: pd.DataFrame) -> str:
    """The mean confidence."""
    return f"{windows.confidence.mean():.3f}"


def report_families(windows: pd.DataFrame) -> str:
    """What a reader knows of a family that its training lacked, beside one that was trained alike with all families."""
    without = windows[windows.reader != "all"]
    pairs = without[["reader", "source"]].drop_duplicates()
    with_all = windows[windows.reader == "all"].drop(columns="reader").merge(pairs, on="source")
    windows = pd.concat([without.assign(training="without"), with_all.assign(training="with")])
    windows = windows.assign(family=windows.reader.str.removeprefix("without "))
    columns = {"windows": lambda part: size(part[part.training == "with"])}
    columns |= across("training", ("with", "without"), rate("exact"), "exact, {}")
    columns |= across("training", ("with", "without"), format_confidence, "mean confidence, {}")
    columns |= across("training", ("without",), measure_doubt, "AUROC of low confidence, {}")
    return pivot(windows, {"left out": "family", "source": "source"}, columns)


def report(rows: pd.DataFrame, study: str) -> str:
    """The tables of a study."""
    level = pd.cut(rows.confidence.clip(1e-6), CONFIDENCES).astype(str)
    rows = rows.assign(set=rows.source.str.partition("/")[0], level=level)
    rows["unit"] = rows.source.where(rows.set.str.startswith("open"), rows.episode.astype(str))  # laws, or windows
    windows = rows.drop_duplicates(KEYS)
    if study == "ablation":
        return pivot(windows, {"reader": "reader", "dropped": "dropped"}, across("set", SUITES, rate("exact")))
    if study == "families":
        return report_families(windows)
    columns: dict[str, CellFormatter] = {"windows": size, "exact": rate("exact", group="unit")}
    columns |= {"mean confidence": format_confidence, "AUROC of low confidence": measure_doubt}
    columns = {name: partial(lambda say, part: say(part.drop_duplicates(KEYS)), say) for name, say in columns.items()}
    columns["calibration error"] = measure_calibration
    by_level = rows.sort_values("level", ascending=False, kind="stable")
    tables = (rows, {"set": "set", "leads": "leads"}), (rows, {"leads": "leads"}), (by_level, {"confidence": "level"})
    parts = [pivot(part, lines, columns) for part, lines in tables]
    is_law = {label: rows.set.isin(sets) for label, sets in LAWS.items()}
    laws = rows.assign(laws=np.select(list(is_law.values()), list(is_law), "")).sort_values("bin")
    texts = across("laws", LAWS, measure_reliability, "laws {}: mean p; heads; UAVs")
    return "\n\n".join([*parts, pivot(laws, {"tenth of p(head)": "bin"}, texts)])


def main(argv: list[str] | None = None) -> None:
    parser = shared.make_parser(__doc__, Path("out/reader"))
    parser.add_argument("study", choices=STUDIES)
    parser.add_argument("names", nargs="*", help="families or groups of features; by default all")
    parser.add_argument("--episodes", type=int, default=50, help="windows of each source, at most those of its suite")
    parser.add_argument("--readers", type=Path, default=Path("out/reader"), help="folder of the trainings")
    parser.add_argument("--shards", type=int, default=25, help="of a training")
    parser.add_argument("--device", choices=["cpu", "cuda"], default="cpu")
    options = parser.parse_args(argv)
    episodes = {name: suite.episodes for name, suite in list_suites().items()}
    keys = [
        (*key, episode)
        for key in dict.fromkeys(choose_windows(options))
        for episode in range(min(options.episodes, episodes.get(key[2].partition("/")[0], options.episodes)))
    ]
    games = [dict(zip(KEYS, key, strict=True)) for key in keys]
    options.rows /= f"{options.study}.csv.gz"
    rows = shared.run_missing(options, games, partial(play, readers=options.readers, seed=options.seed))
    print(report(rows, options.study))
    if options.study == "calibration":
        rows = rows.assign(set=rows.source.str.partition("/")[0])
        draw_reliability(rows, options.images.parent / "reader-reliability.png")


if __name__ == "__main__":
    main()
