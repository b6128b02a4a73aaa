"""Play frozen suites, and keep the rows that the tables need, in one compressed file a suite.

    python benchmarks/suites.py paper --workers 2                      # all detectors, by way of out/suites/paper
    python benchmarks/suites.py paper --detector none --episodes 5 --out out/look --results out/look
    python benchmarks/suites.py paper --add out/mine/paper             # plays nothing: adds the rows of a run
    python benchmarks/suites.py open --draw                            # plays nothing: draws the suite's seed, once

`--add` takes the folder of a run of `usnet evaluate --suite paper --seed SEED --out out/mine/paper`, where SEED is what
`python benchmarks/suites.py paper --print-seed` prints: then it met the swarms of the committed rows. The rows of a
detector that is played or added replace those that the file holds.
"""

from __future__ import annotations

import secrets
import subprocess
from hashlib import sha256
from pathlib import Path
from typing import Any

import pandas as pd
from paper.shared import RESULTS, ROOT, make_parser, read_rows, write_rows

from usnet_env.evaluation import EvaluationResult, Suite, evaluate_suite, list_suites, load_suite
from usnet_env.evaluation.published import published_seed
from usnet_env.files import write_text

COLUMNS = ("cell", "detector", "episode", "swarm_seed", "J", "exact", "f1_first", "seconds_per_round", "error")
DETECTORS = (
    "none", "random", "destroy-all", "central-most", "track-outlier", "reader(weights='untrained')",
    "reader(weights='blind')", "one-per-round", "front-most", "lagged-correlation", "lagged-regression", "factions",
    "granger", "reader", "reader(policy='map')", "directional-delays",
    "lagged-network", "net-lag-regression", "flica", "mflica", "transfer-entropy",
    "gassl(steps=0)", "mc-gassl(gassl={'steps': 0})", "mc-gassl", "neural-granger", "gassl",
)  # fmt: skip
#: Episodes of detectors that are too slow for all those of a suite, by suite.
FEWER = {"paper": {"gassl": 1, "gassl(steps=0)": 10, "mc-gassl": 3, "neural-granger": 30}}
FEWER["paper"]["mc-gassl(gassl={'steps': 0})"] = 10
FEWER["paper-hard"] = {"gassl": 10, "mc-gassl": 10, "neural-granger": 10}
FEWER["scale"] = dict.fromkeys(("reader(weights='untrained')", "reader(weights='blind')"), 3)
FEWER["open"] = FEWER["open-second"] = dict.fromkeys(("gassl", "mc-gassl", "neural-granger"), 1)
for _suite in ("field-v3", "limit-v2"):
    FEWER[_suite] = {"gassl": 1, "mc-gassl": 1, "neural-granger": 5, "gassl(steps=0)": 10}
    FEWER[_suite]["mc-gassl(gassl={'steps': 0})"] = 5
TIME_LIMITS = {"scale": 60.0}  # seconds for an answer
WEIGHTS = ROOT / "detectors/reader/data/reader.safetensors"


def play(suite: Suite, detectors: list[str], episodes: int | None, folder: Path, **settings: Any) -> list[pd.DataFrame]:
    """Play detectors; those with the same number of episodes share a folder, from which the same call goes on."""
    counts = {name: episodes or FEWER.get(suite.name, {}).get(name, suite.episodes) for name in detectors}
    settings |= {"time_limit": TIME_LIMITS.get(suite.name), "progress": True}
    groups = {count: [name for name in counts if counts[name] == count] for count in counts.values()}
    return [
        evaluate_suite(suite, names, episodes=count, out=folder / str(count), **settings).rows
        for count, names in groups.items()
    ]


def pack(suite: Suite, parts: list[pd.DataFrame], path: Path) -> None:
    """Put the rows of some detectors into the file of a suite.

    Raises:
        ValueError: a detector lacks an episode of a cell, or an episode has other swarms than the rows of the file.
    """
    new = pd.concat(parts)[list(COLUMNS)]
    new["error"] = new["error"].replace("", None)
    for (name, cell), rows in new.groupby(["detector", "cell"]):
        if sorted(rows.episode) != list(range(new[new.detector == name].episode.max() + 1)):
            raise ValueError(f"{name} must play the same episodes of every cell of {suite.label}, some of {cell} lack.")
    missing = set(suite.cells) - set(new["cell"])
    if missing:
        raise ValueError(f"the rows must be of all cells of {suite.label}, got none of {', '.join(sorted(missing))}.")
    old = read_rows(path) if path.exists() else new[:0]
    rows = pd.concat([part for part in (old[~old.detector.isin(new.detector)], new) if len(part)])
    if (rows.groupby(["cell", "episode"]).swarm_seed.nunique() > 1).any():
        raise ValueError(f"the rows must be of the swarms of {path.name}: play with --seed {published_seed(suite)}.")
    rows["exact"] = rows["exact"].astype("Int64")
    rows[["J", "f1_first", "seconds_per_round"]] = rows[["J", "f1_first", "seconds_per_round"]].map("{:.4g}".format)
    rows["cell"] = pd.Categorical(rows["cell"], list(suite.cells))
    write_rows(path, rows.replace("nan", None).sort_values(["cell", "detector", "episode"]))


def draw_seed(path: Path, weights: Path) -> int:
    """Draw the seed of a suite whose file names the committed weights, and write it in place of the one before.

    Raises:
        ValueError: the file names other weights, is not committed, or has a seed that was drawn after these weights.
    """
    suite, digest = load_suite(path), sha256(weights.read_bytes()).hexdigest()

    def git(*words: str | Path) -> str:
        return subprocess.run(["git", *words], cwd=path.parent, capture_output=True, text=True, check=True).stdout

    if suite.weights != digest:
        raise ValueError(f"weights in {path.name} must be {digest}, that of {weights.name}, got {suite.weights}.")
    if git("status", "--porcelain", "--", path, weights):
        raise ValueError(f"{path.name} and {weights.name} must be committed before the draw.")
    committed = git("log", "-1", "--format=%H", f"-S{digest}", "--", path).strip()  # the commit that named the weights
    if f"\nseed: {suite.seed}\n" not in git("show", f"{committed}:./{path.name}"):
        raise ValueError(f"the seed in {path.name} was drawn after these weights; another draw needs other weights.")
    seed = secrets.randbits(63)
    write_text(path, path.read_text(encoding="utf-8").replace(f"seed: {suite.seed}", f"seed: {seed}"))
    return seed


def main(argv: list[str] | None = None) -> None:
    parser = make_parser(__doc__)
    parser.add_argument("suite", choices=list(list_suites()))
    parser.add_argument("--detector", action="append", help="may repeat; by default all that the tables show")
    parser.add_argument("--episodes", type=int, help="by default those of the suite, fewer of slow detectors")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("out/suites"), help="folder of the runs")
    parser.add_argument("--results", type=Path, default=RESULTS / "suites", help="folder of the compressed rows")
    parser.add_argument(
        "--add", type=Path, nargs="+", metavar="FOLDER", help="add the rows of these runs, play nothing"
    )
    parser.add_argument("--print-seed", action="store_true", help="print the seed of the committed rows, play nothing")
    parser.add_argument("--draw", action="store_true", help="draw the seed of a suite with weights, play nothing")
    parser.set_defaults(seed=None)  # that of the committed rows
    options = parser.parse_args(argv)
    suite = load_suite(options.suite)
    path = options.results / f"{suite.name}-v{suite.version}.csv.gz"
    if options.draw:
        print(draw_seed(ROOT / f"usnet_env/evaluation/suites/{suite.name}.yaml", WEIGHTS))
    elif options.print_seed:
        print(published_seed(suite))
    elif options.add:
        pack(suite, [EvaluationResult.load(folder).rows for folder in options.add], path)
    else:
        names = options.detector or list(DETECTORS)
        settings = {"seed": options.seed or published_seed(suite), "workers": options.workers}
        pack(suite, play(suite, names, options.episodes, options.out / suite.name, **settings), path)


if __name__ == "__main__":
    main()
