"""Answers that a change of structure must keep: rows of the four suites, and what ``usnet detect`` says of files.

    python tests/golden/golden.py rows FILE.csv              # plays all rows; goes on where it stopped
    python tests/golden/golden.py detect FILE.json [CASES]   # the files of examples/make_tracks.py, and of a folder

Both files are of the commits that changed them last. The seed is that of no published table.
"""

import argparse
import io
import json
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from contextlib import redirect_stdout
from pathlib import Path

import pandas as pd

from usnet_env.cli import main
from usnet_env.evaluation import evaluate, load_suite

FOLDER = Path(__file__).parent
SEED = 770_077
SUITES = ("paper", "controls-v2", "sensing-v2", "field-v2")
QUICK = (
    "random", "destroy-all", "none", "one-per-round", "lagged-correlation", "lagged-regression", "granger", "factions",
    "front-most", "directional-delays", "lagged-network", "net-lag-regression", "flica", "mflica", "transfer-entropy",
)  # fmt: skip
DETECTOR = "lagged-network"  # of ``usnet detect``; the default's weights may change
SLOW = ("gassl(times='mean')", "mc-gassl(gassl={'times': 'mean'})", "neural-granger")
SLOW_CELLS = ("paper/f1", "controls-v2/shepherd", "sensing-v2/missed")
KEYS = ["cell", "detector", "episode"]
KEPT = [
    *KEYS, "swarm_seed", "detector_seed", "uavs", "heads", "J", "rounds", "redundancy", "success", "exact",
    "precision_first", "recall_first", "f1_first", "ap_first", "purity_first", "head_in_cluster_first",
]  # fmt: skip


def play_cell(name: str, detectors: Sequence[str], episodes: int) -> pd.DataFrame:
    """The rows of one cell, such as ``"paper/f1"``."""
    suite, cell = name.split("/")
    setting = load_suite(suite).cells[cell]
    result = evaluate(setting.env, list(detectors), env_kwargs=setting.arguments, episodes=episodes, seed=SEED)
    return result.rows.assign(cell=name).reindex(columns=KEPT)


def list_cells(suites: Iterable[str] = SUITES) -> Iterator[tuple[str, tuple[str, ...], int]]:
    for name in SLOW_CELLS:
        if name.split("/")[0] in suites:
            yield name, SLOW, 1
    for suite in suites:
        for cell in load_suite(suite).cells:
            yield f"{suite}/{cell}", QUICK, 2


def play_rows(path: Path, suites: Iterable[str]) -> None:
    known = set(zip(*(pd.read_csv(path)[name] for name in KEYS[:2]), strict=True)) if path.exists() else set()
    for name, detectors, episodes in list_cells(suites):
        missing = [each for each in detectors if (name, each) not in known]
        if missing:
            play_cell(name, missing, episodes).to_csv(path, mode="a", header=not path.exists(), index=False)
            print(f"{name}: {len(missing)} detectors", flush=True)


def detect(files: Iterable[Path]) -> dict[str, object]:
    """The answers of ``usnet detect --json`` by the name of the file; of a refused file, its exit status."""
    answers: dict[str, object] = {}
    for file in files:
        with redirect_stdout(io.StringIO()) as printed:
            status = main(["detect", str(file), "--detector", DETECTOR, "--json"])
        answers[file.name] = {"status": status} if status else read_answers(printed.getvalue())
    return answers


def read_answers(text: str) -> dict[str, object]:
    """Answers from JSON; their last digits, which depend on the processor, are dropped as in :func:`differing_rows`."""
    return dict(json.loads(text, parse_float=lambda number: round(float(number), 8)))


def make_tracks(folder: Path) -> list[Path]:
    script = FOLDER.parents[1] / "examples" / "make_tracks.py"
    subprocess.run([sys.executable, script], cwd=folder, check=True, capture_output=True)
    return sorted(folder.glob("*.csv"))


def differing_rows(old: pd.DataFrame, new: pd.DataFrame) -> list[str]:
    """One line for each row of ``old`` that ``new`` has with other values, or lacks."""
    one, other = (frame.set_index(KEYS).sort_index() for frame in (old, new))
    other = other.reindex(one.index)[one.columns]
    same = ((one - other).abs() < 1e-8) | (one.isna() & other.isna())
    lines = []
    for key in one.index[~same.all(axis=1)]:
        values = (f"{name} {one.loc[key, name]} -> {other.loc[key, name]}" for name in one if not same.loc[key, name])
        lines.append(f"{' '.join(map(str, key))}: {', '.join(values)}")
    return lines


def run_command() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("command", choices=["rows", "detect"])
    parser.add_argument("paths", nargs="+", type=Path)
    parser.add_argument("--suites", nargs="+", default=SUITES)
    given = parser.parse_args()
    if given.command == "rows":
        play_rows(given.paths[0], given.suites)
    else:
        with tempfile.TemporaryDirectory() as folder:
            cases = [file for path in given.paths[1:] for file in sorted(path.glob("*.[ct][sx][vt]"))]
            answers = detect([*make_tracks(Path(folder)), *cases])
        given.paths[0].write_text(json.dumps(answers, indent=1, sort_keys=True) + "\n", encoding="utf-8")


if __name__ == "__main__":
    run_command()
