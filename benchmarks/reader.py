"""What the reader owes to its prior, its size and its features, and whether its probabilities are right.

    python benchmarks/reader.py families --workers 2       # a family left out of a short training, one after another
    python benchmarks/reader.py scaling                    # widths and numbers of shards, with a figure
    python benchmarks/reader.py ablation                   # a group of features without information; also --retrained
    python benchmarks/reader.py calibration                # of the shipped weights, in suites and families

Trainings are kept in the folder --readers and rows in the folder --rows, and the same command goes on where it
stopped. A source is a cell of a suite, of which the first round is read, or a family of the prior. A row is a window
and a tenth of the range of p(head), with the number of its UAVs, the sum of their p and the number of their heads.
"""

from __future__ import annotations

import json
from argparse import Namespace
from collections.abc import Iterable
from contextlib import nullcontext
from functools import partial
from importlib.resources import files
from itertools import product
from pathlib import Path
from typing import Any
from unittest.mock import patch
from zlib import crc32

import numpy as np
import pandas as pd
from paper import shared
from pivot import across, pivot, rate, size
from safetensors.numpy import load_file
from scipy import special
from sklearn.metrics import roc_auc_score

from detectors.reader.features import CONTEXT_GROUPS, PAIR_GROUPS, UAV_GROUPS, make_features
from detectors.reader.forward import load_reader, read
from detectors.reader.prior import FAMILIES, draw_examples
from usnet_env import Window
from usnet_env.evaluation import list_suites, load_suite
from usnet_env.progress import progress_bar

KEYS = ["reader", "dropped", "source", "episode"]
SUITES = ("field-v2", "controls-v2", "sensing-v2")
KINDS = {"pair": PAIR_GROUPS, "uav": UAV_GROUPS, "context": CONTEXT_GROUPS}
GROUPS = {name: (kind, part) for kind, groups in KINDS.items() for name, part in groups.items()}
SIZES = {f"width {width}, {shards} shards": (width, shards) for width in (16, 32, 48) for shards in (10, 30, 90)}
NONE, SHIPPED = "nothing", "shipped"  # no group is dropped; the weights of the package
CONFIDENCES = (0.0, 0.2, 0.4, 0.6, 0.8, 0.95, 1.0)
Played = Iterable[tuple[str, str, str]]  # reader, dropped group, source


def find_weights(readers: Path, label: str) -> Path:
    """The weights file of a training, or of the package."""
    data = Path(str(files("detectors.reader"))) / "data"
    return (data if label == SHIPPED else readers / label) / "reader.safetensors"


def train(given: Namespace, label: str, group: str = NONE, **settings: Any) -> None:
    """Train a reader unless its weights are there; a group of features has its mean in every batch."""
    from detectors.reader import train as training

    path = find_weights(given.readers, label)
    if label == SHIPPED or path.exists() or given.draw:
        return
    hidden = {} if group == NONE else {"_GROUPS": [GROUPS[group]], "_DROPPED": 1.0}
    settings = {"shards": given.shards, "device": given.device, "seed": given.seed} | settings
    with progress_bar(label) as progress, patch.multiple(training, **hidden) if hidden else nullcontext():
        training.train_reader(path.parent, training.ReaderTraining(**settings), progress, workers=given.workers)


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


def ask(path: Path, window: Window, dropped: str) -> tuple[np.ndarray, float]:
    """``(N,)`` p(head), and p(nobody leads); a group of features that is dropped has its mean in the training."""
    flying = np.flatnonzero(window.velocity_seen.any(axis=0))
    features = make_features(window.position[:, flying], window.velocity[:, flying], window.seen[:, flying])
    weights = shared.remember(load_reader, str(path))
    if dropped != NONE:
        kind, part = GROUPS[dropped]
        getattr(features, kind)[..., part] = weights[f"{kind}_mean"][part]
    answer, p = read(weights, features), np.zeros(window.uavs)
    p[flying] = special.expit(answer.head.astype(float))
    return p, float(special.expit(answer.silent))


def play(game: shared.Game, readers: Path, seed: int) -> list[dict[str, Any]]:
    """Read one window."""
    window, head = draw_window(game["source"], game["episode"], seed)
    p, silent = ask(find_weights(readers, game["reader"]), window, game["dropped"])
    about = game | {
        "exact": int(((p > 0.5) == head).all()),
        "confidence": np.maximum(p, 1 - p).prod(),
        "silent": silent,
    }
    about["leads"] = "some UAV" if head.any() else "nobody"
    bins = pd.DataFrame({"uavs": 1, "p": p, "heads": head.astype(int)}).groupby(np.minimum(10 * p, 9).astype(int)).sum()
    return [{**about, "bin": k, **sums} for k, sums in bins.to_dict("index").items()]


def list_cells(suites: Iterable[str] = SUITES, family: str = "") -> list[str]:
    """The cells of suites, or those with the name of a family as a part of their name."""
    part = family.removeprefix("fault:")
    names = [(suite, cell) for suite in suites for cell in load_suite(suite).cells]
    return [f"{suite}/{cell}" for suite, cell in names if not part or part in cell.split("-")]


def choose(given: Namespace) -> Played:
    """What a study plays, after the trainings that it needs."""
    if given.study == "families":
        train(given, "all")
        yield from product(["all"], [NONE], list_cells(["paper"]))  # f1 to f7 are in no prior
        for family in given.names or [name for name in FAMILIES if name != "field"]:
            train(given, f"without {family}", without=(family,))
            yield from product(["all", f"without {family}"], [NONE], [f"prior/{family}", *list_cells(family=family)])
    elif given.study == "scaling":
        for label, (width, shards) in SIZES.items():
            train(given, label, width=width, shards=shards)
            yield from product([label], [NONE], list_cells())
    elif given.study == "ablation":
        for group in [NONE, *(given.names or GROUPS)]:
            label = f"without {group}" if given.retrained and group != NONE else SHIPPED
            train(given, label, group)
            yield from product([label], [group], list_cells())
    else:
        cells = list_cells(["paper", *SUITES, "open", "limit"])
        yield from product([SHIPPED], [NONE], [*cells, *(f"prior/{family}" for family in FAMILIES)])


def measure_calibration(rows: pd.DataFrame) -> str:
    """The expected calibration error of p(head)."""
    sums = rows.groupby("bin")[["uavs", "p", "heads"]].sum()
    return f"{(sums.p - sums.heads).abs().sum() / max(sums.uavs.sum(), 1):.4f}"


def measure_doubt(windows: pd.DataFrame) -> str:
    """The AUROC of 1 - confidence for windows that are not exact."""
    errors = 1 - windows.exact
    return "–" if errors.nunique() < 2 else f"{roc_auc_score(errors, 1 - windows.confidence):.3f}"


def say_confidence(windows: pd.DataFrame) -> str:
    """The mean confidence."""
    return f"{windows.confidence.mean():.3f}"


def report_families(windows: pd.DataFrame) -> str:
    """What a reader knows of a family that its training lacked, beside one that was trained alike with all families."""
    left = windows[windows.reader != "all"]
    pairs = left[["reader", "source"]].drop_duplicates()
    known = windows[windows.reader == "all"].drop(columns="reader").merge(pairs, on="source")
    both = pd.concat([left.assign(training="without"), known.assign(training="with")])
    both = both.assign(family=both.reader.str.removeprefix("without "))
    says = {"windows": lambda part: size(part[part.training == "with"])}
    says |= across("training", ("with", "without"), rate("exact"), "exact, {}")
    says |= across("training", ("with", "without"), say_confidence, "mean confidence, {}")
    says |= across("training", ("without",), measure_doubt, "errors by 1 - confidence, {}")
    return pivot(both, {"left out": "family", "source": "source"}, says)


def report(rows: pd.DataFrame, study: str) -> str:
    """The tables of a study."""
    sure = pd.cut(rows.confidence.clip(1e-6), CONFIDENCES).astype(str)
    rows = rows.assign(set=rows.source.str.partition("/")[0], sure=sure)
    rows["unit"] = rows.source.where(rows.set == "open", rows.episode.astype(str))  # laws, or windows
    windows = rows.drop_duplicates(KEYS)
    says = {"windows": size, "exact": rate("exact", group="unit"), "mean confidence": say_confidence}
    says["errors by 1 - confidence"] = measure_doubt
    if study in ("scaling", "ablation"):
        lines = {"reader": "reader"} | ({"dropped": "dropped"} if study == "ablation" else {})
        return pivot(windows, lines, across("set", SUITES, rate("exact")))
    if study == "families":
        return report_families(windows)
    tables: list[dict[str, str]] = [{"set": "set", "leads": "leads"}, {"leads": "leads"}, {"confidence": "sure"}]
    errors = {"calibration error": measure_calibration}
    return "\n\n".join(pivot(part, line, say) for line in tables for part, say in ((windows, says), (rows, errors)))


def draw_sizes(rows: pd.DataFrame, readers: Path, images: Path) -> None:
    """The loss of the last shards and the share of exact windows, against parameters times windows."""
    exact, (figure, panels) = rows.drop_duplicates(KEYS).groupby("reader").exact, shared.panels(9, 4.2, 1, 2)
    for color, width in zip(shared.COLORS, dict.fromkeys(width for width, _ in SIZES.values()), strict=False):
        points = []
        for label, (_, shards) in [item for item in SIZES.items() if item[1][0] == width]:
            path = find_weights(readers, label)
            record = json.loads(path.with_suffix(".json").read_text(encoding="utf-8"))
            windows = shards * record["training"]["batches"] * record["training"]["windows"]
            parameters = sum(array.size for array in load_file(path).values())
            points.append((parameters * windows, record["metrics"]["last_loss"], exact.mean()[label]))
        cost, *values = zip(*points, strict=True)
        for axes, name, value in zip(panels[0], ("loss", "exact"), values, strict=True):
            axes.plot(cost, value, "o-", color=color, label=f"width {width}")
            axes.set(xscale="log", xlabel="parameters × windows of the training", ylabel=name)
    caption = f"n = {exact.size().min()} windows of {', '.join(SUITES)} a point."
    shared.save_figure(figure, images / "reader-scaling.png", "The reader's size and its training", caption)


def main(argv: list[str] | None = None) -> None:
    parser = shared.parse(__doc__, Path("out/reader"))
    parser.add_argument("study", choices=["families", "scaling", "ablation", "calibration"])
    parser.add_argument("names", nargs="*", help="families or groups of features; by default all")
    parser.add_argument("--episodes", type=int, default=50, help="windows of each source, at most those of its suite")
    parser.add_argument("--readers", type=Path, default=Path("out/reader"), help="folder of the trainings")
    parser.add_argument("--shards", type=int, default=25, help="of a training, except in scaling")
    parser.add_argument("--device", choices=["cpu", "cuda"], default="cpu")
    parser.add_argument("--retrained", action="store_true", help="ablation: train without each group")
    given = parser.parse_args(argv)
    most = {name: suite.episodes for name, suite in list_suites().items()}
    played = [
        (*key, episode)
        for key in dict.fromkeys(choose(given))
        for episode in range(min(given.episodes, most.get(key[2].partition("/")[0], given.episodes)))
    ]
    games = [dict(zip(KEYS, each, strict=True)) for each in played]
    given.rows /= f"{given.study}.csv.gz"
    rows = shared.measure(given, games, partial(play, readers=given.readers, seed=given.seed))
    print(report(rows, given.study))
    if given.study == "scaling":
        draw_sizes(rows, given.readers, given.images)


if __name__ == "__main__":
    main()
