"""Make files for ``usnet detect`` from two public sets of recorded tracks whose leaders are known.

    python examples/fetch_tracks.py                        # lists the sets
    python examples/fetch_tracks.py ants cars --out data   # fetches them with git, and writes data/ants/*.csv, ...
    python examples/fetch_tracks.py ants --clone PATH --out data   # from a clone that is there already

ants: tandem runs of *Diacamma* cf. *indicum*, a leader and a follower in each of 27 runs, filmed at 29.97 Hz (Mizumoto
et al., iScience 26, 2023, doi 10.1016/j.isci.2023.106418). Times at which the tracking failed are left out.

cars: platoons of five cars, 10 Hz (Lanaud et al., Transport Findings, 2021). Positions are the integral of the speed of
the wheels, and the first distances are those of the radars. In data9 and data12, which are left out,
clocks disagree.

The data belong to their authors; neither repository states a licence. Each file has the columns id, t, x, y (metres)
and leader, the id that each id follows directly. Ids are drawn at random, so that their order tells nothing.
"""

from __future__ import annotations

import argparse
import csv
import io
import subprocess
import zlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np

SETS = {
    "ants": ("https://github.com/nobuaki-mzmt/diacamma-tandem", "07d80a39aa9edcf31ff191d1fa530fad34f6ca10"),
    "cars": ("https://github.com/licit-lab/vrt_analysis", "fcdc1b15ad9a7f59b5f9c0ac6a626747344e5099"),
}
ANTS, FAILED = "data/trajectory/raw/Diacamma-csv/", "data/trajectory/Tracking_failed.csv"
PIXELS = {"KC": 738.6533333, "KH": 755.24, "KN": 1108.373333, "NA": 1090.64}  # of the arena's 1 m, by colony
FRAMES = 29.97  # a second
CARS = ("leader", "follower1", "follower2", "follower3", "follower4")
Row = tuple[str, float, float, float, str]


def show(clone: Path, path: str, commit: str) -> str | None:
    """The text of a file at a commit; ``None`` if the clone lacks it."""
    done = subprocess.run(["git", "-C", clone, "show", f"{commit}:{path}"], capture_output=True)
    return done.stdout.decode("utf-8-sig") if done.returncode == 0 else None


def name_ids(run: str, count: int, kind: str) -> list[str]:
    """Names in an order that depends on the run only."""
    return [f"{kind}-{k}" for k in np.random.default_rng(zlib.crc32(run.encode())).permutation(count)]


def read_ants(clone: Path, commit: str) -> Iterator[tuple[str, list[Row]]]:
    """The runs: name and rows."""
    listed = subprocess.run(
        ["git", "-C", clone, "ls-tree", "--name-only", commit, ANTS], capture_output=True, text=True, check=True
    )
    failed = list(csv.reader(io.StringIO(show(clone, FAILED, commit) or "")))[1:]
    for path in listed.stdout.split():
        name = path.removeprefix(ANTS).partition("_extract")[0].replace("_eve", "")
        run = f"{name[:2]}{int(name[2:]):02d}"
        if (text := show(clone, path, commit)) is None:
            continue
        table = np.genfromtxt(io.StringIO(text), delimiter=",", skip_header=1, usecols=range(5))
        kept = np.isfinite(table).all(axis=1)
        for _, first, last, *_ in (each for each in failed if each[0] == run):
            kept[max(0, int(first) - 1) : int(last) + 1] = False
        ids = name_ids(run, 2, "ant")
        yield (
            run,
            [
                (
                    ids[k],
                    round(row[0] / FRAMES, 4),
                    row[1 + 2 * k] / PIXELS[run[:2]],
                    row[2 + 2 * k] / PIXELS[run[:2]],
                    led,
                )
                for row in table[kept]
                for k, led in ((0, ""), (1, ids[0]))
            ],
        )


def read_cars(clone: Path, commit: str) -> Iterator[tuple[str, list[Row]]]:
    """The platoons: name and rows."""
    for number in (5, 6, 10, 13):
        if (text := show(clone, f"data/raw/carma/data{number}.csv", commit)) is None:
            continue
        lines = sorted(csv.DictReader(io.StringIO(text)), key=lambda line: float(line["Time"]))
        times = np.array([float(line["Time"]) for line in lines])
        fresh = np.append(True, np.diff(times) > 1e-6)
        run, start = f"data{number}", 0.0
        ids, rows = name_ids(run, len(CARS), "car"), []
        for k, car in enumerate(CARS):
            speed = np.array([float(line[f"{car}_avg_speed_driven_wheels"] or "nan") for line in lines])
            known = np.isfinite(speed) & fresh
            start -= float(lines[0][f"{car}_radar1"]) if k else 0.0
            place = start + np.append(0, np.cumsum(np.diff(times[known]) * (speed[known][1:] + speed[known][:-1]) / 2))
            led = ids[k - 1] if k else ""
            rows += [(ids[k], round(t, 3), x, 0.0, led) for t, x in zip(times[known], place, strict=True)]
        yield run, sorted(rows, key=lambda row: row[1])


def main() -> None:
    """Fetch what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sets", nargs="*", choices=[[], *SETS], help="ants, cars")
    parser.add_argument("--out", type=Path, default=Path("tracks"))
    parser.add_argument("--clone", type=Path, help="a clone of the repository; with one set only")
    arguments = parser.parse_args()
    if not arguments.sets:
        print("\n".join(f"{name}: {address}" for name, (address, _) in SETS.items()))
    for name in arguments.sets:
        address, commit = SETS[name]
        clone = arguments.clone or arguments.out / f"{name}.git"
        if not clone.exists():
            subprocess.run(["git", "clone", "--bare", address, clone], check=True)
        folder = arguments.out / name
        folder.mkdir(parents=True, exist_ok=True)
        for run, rows in {"ants": read_ants, "cars": read_cars}[name](clone, commit):
            with (folder / f"{run}.csv").open("w", newline="", encoding="utf-8") as file:
                writer = csv.writer(file)
                writer.writerow(["id", "t", "x", "y", "leader"])
                writer.writerows((i, t, f"{x:.5f}", f"{y:.5f}", led) for i, t, x, y, led in rows)
            print(f"{folder / run}.csv: {len(rows)} rows")


if __name__ == "__main__":
    main()
