"""Whether the reader's probabilities are right.

    python benchmarks/reader.py    # of the shipped weights, in suites and families

The same command goes on where it stopped. A source is a cell of a suite, of which the first round is read, or a family
of the prior. A row is a window and a tenth of the range of p(head), with the number of its UAVs, the sum of their p and
the number of their heads.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np
import pandas as pd
from paper import shared
from pivot import CellFormatter, across, pivot, rate, size
from scipy import special
from sklearn.metrics import roc_auc_score

from detectors.reader.features import make_features
from detectors.reader.forward import load_reader, predict
from detectors.reader.prior import FAMILIES, draw_examples
from usnet_env import Window
from usnet_env.evaluation import list_suites, load_suite

KEYS = ["source", "episode"]
SUITES = ("field-v2", "controls-v2", "sensing-v2")
CONFIDENCES = (0.0, 0.2, 0.4, 0.6, 0.8, 0.95, 1.0)
#: Sets of windows of the reliability curve: of laws that the prior has, and of laws that it hasn't.
LAWS = {"in the prior": ("prior", *SUITES), "not in the prior": ("open", "open-second")}


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


def read_window(window: Window) -> tuple[np.ndarray, float]:
    """``(N,)`` p(head), and p(no UAV leads)."""
    flying = np.flatnonzero(window.velocity_seen.any(axis=0))
    features = make_features(window.position[:, flying], window.velocity[:, flying], window.seen[:, flying])
    answer, p = predict(shared.cached(load_reader), features), np.zeros(window.uavs)
    p[flying] = special.expit(answer.head.astype(float))
    return p, float(special.expit(answer.silent))


def play(game: shared.Game, seed: int) -> list[dict[str, Any]]:
    """Read one window."""
    window, head = draw_window(game["source"], game["episode"], seed)
    p, p_no_leader = read_window(window)
    row = game | {
        "exact": int(((p > 0.5) == head).all()),
        "confidence": np.maximum(p, 1 - p).prod(),
        "silent": p_no_leader,
    }
    row["leads"] = "some UAV" if head.any() else "no UAV"
    bins = pd.DataFrame({"uavs": 1, "p": p, "heads": head.astype(int)}).groupby(np.minimum(10 * p, 9).astype(int)).sum()
    return [{**row, "bin": k, **sums} for k, sums in bins.to_dict("index").items()]


def list_sources() -> list[str]:
    """The cells of the suites, and the families of the prior."""
    suites = ("paper", *SUITES, "open", "open-second", "limit")
    cells = [f"{suite}/{cell}" for suite in suites for cell in load_suite(suite).cells]
    return [*cells, *(f"prior/{family}" for family in FAMILIES)]


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


def report(rows: pd.DataFrame) -> str:
    """The tables of windows and of p(head)."""
    level = pd.cut(rows.confidence.clip(1e-6), CONFIDENCES).astype(str)
    rows = rows.assign(set=rows.source.str.partition("/")[0], level=level)
    rows["unit"] = rows.source.where(rows.set.str.startswith("open"), rows.episode.astype(str))  # laws, or windows
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
    parser = shared.make_parser(__doc__, Path("out/reader/calibration.csv.gz"))
    parser.add_argument("--episodes", type=int, default=50, help="windows of each source, at most those of its suite")
    options = parser.parse_args(argv)
    episodes = {name: suite.episodes for name, suite in list_suites().items()}
    games = [
        dict(zip(KEYS, (source, episode), strict=True))
        for source in list_sources()
        for episode in range(min(options.episodes, episodes.get(source.partition("/")[0], options.episodes)))
    ]
    rows = shared.run_missing(options, games, partial(play, seed=options.seed))
    print(report(rows))
    rows = rows.assign(set=rows.source.str.partition("/")[0])
    draw_reliability(rows, options.images.parent / "reader-reliability.png")


if __name__ == "__main__":
    main()
