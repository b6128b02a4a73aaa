"""Recordings that no detector met before: pairs of termites, of which the female leads, and platoons of cars.

    git clone https://github.com/nobuaki-mzmt/SexMovementAfterSeparation data/termites        # commit 9158473
    git clone https://github.com/thibault-charlottin/ACC-platoon-fuel-consumption data/platoons   # commit 8781ec3
    OMP_NUM_THREADS=1 python benchmarks/recordings.py data    # --weights FILE: other weights of the reader

A row is a detector's answer to a window. The step and the length of windows are those of ``usnet detect`` without
options; longer recordings have 6 windows at equal distances. A detector whose rows are in the file isn't played again;
those of a reader have the first digits of the hash of its weights.

Truth. Termites (Mizumoto and Dobata, Science Advances 5, 2019): the male follows the female while they are at most as
far apart as the authors allow in a tandem run; x0, y0 is the female, as in their code. Only the films of tandem runs
are used, not those of the same animal alone before and after. Platoons (OpenACC, the campaign at ZalaZone; Makridis et
al., Transportation Research Part C 125, 2021): each car follows the nearest car in front of it that has a track, by the
order that the file names. The first car of that order has a track in the set ``platoons`` only. Files of 4 MiB and more
are left out. A window counts if an id moves in it, and an id follows another one for most of it.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterator
from hashlib import sha256
from pathlib import Path
from time import process_time
from typing import Any
from zlib import crc32

import numpy as np
import pandas as pd
from paper.shared import RESULTS, ROOT, read_rows, write_rows
from pivot import CellFormatter, fold, mean_by_recording, median, pivot, share

from usnet_env import make_detector
from usnet_env.objectives import find_roots
from usnet_env.tracks import Tracks, find_leaders, read_tracks

ROWS = RESULTS / "recordings.csv.gz"
SHIPPED = ROOT / "detectors/reader/data/reader.safetensors"
DETECTORS = (
    "reader(policy='map')", "reader", "reader(weights='blind')", "reader(weights='untrained')", "lagged-network",
    "mflica", "front-most", "central-most", "track-outlier", "destroy-all", "random", "none",
)  # fmt: skip
MAX_WINDOWS, MAX_BYTES = 6, 2**22  # windows of a recording; bytes of a file
FRAMES, ARENA = 30, 145.0  # a second; mm that both animals together cross
MAX_DISTANCE = {"Rs": 7.0, "Cf": 10.0}  # mm, the size of an animal with its antennae
TITLES = {
    "Rs": "Termites, <i>Reticulitermes speratus</i>: a female and the male behind her",
    "Cf": "Termites, <i>Coptotermes formosanus</i>: a female and the male behind her",
    "platoons": "Cars: platoons of 4 to 11, whose first car has a track",
    "platoons-unseen": "Cars: platoons whose first car has no track; the first one with a track counts as their leader",
}
Recording = tuple[str, str, pd.DataFrame]  # set, name, and samples: id, t (s), x and y (m), leader ("": none)


def name_ids(recording: str, count: int) -> list[str]:
    """Names in an order that depends on the recording only; samples are sorted by them, so that it tells nothing."""
    return [f"id-{k}" for k in np.random.default_rng(crc32(recording.encode())).permutation(count)]


def read_termites(folder: Path) -> Iterator[Recording]:
    """The films of tandem runs; pixels become metres by the range of both animals, as in the authors' code."""
    for path in sorted(folder.glob("analysis/*/**/*_tandem*position*.csv")):
        table, kind = pd.read_csv(path), path.relative_to(folder).parts[1]
        positions = table[["x0", "y0", "x1", "y1"]].to_numpy().reshape(-1, 2, 2)  # (T, animals, axes)
        positions = (positions - np.nanmin(positions, axis=(0, 1))) * ARENA / np.ptp(positions, axis=(0, 1))
        ids, parts = name_ids(path.stem, 2), []
        in_tandem = np.linalg.norm(positions[:, 0] - positions[:, 1], axis=1) <= MAX_DISTANCE[kind]
        for k, leader in enumerate(("", np.where(in_tandem, ids[0], ""))):
            x, y = positions[:, k].T / 1000
            samples = {"id": ids[k], "t": table["position"] / FRAMES, "x": x, "y": y, "leader": leader}
            parts.append(pd.DataFrame(samples))
        yield kind, path.stem, pd.concat(parts).sort_values("id", kind="stable")


def read_platoons(folder: Path) -> Iterator[Recording]:
    """The platoons; the number in the name of a column is the position of the car in the order."""
    for path in sorted(folder.glob("data/OpenACC_data/*/*_part*.csv")):
        if path.stat().st_size >= MAX_BYTES:
            continue
        table = pd.read_csv(path, skiprows=5)
        cars = sorted(int(name[1:]) for name in table if re.fullmatch(r"E\d+", name))
        leader, parts = np.full(len(table), "", object), []
        for car, name in zip(cars, name_ids(path.stem, len(cars)), strict=True):
            samples = table[["Time", f"E{car}", f"N{car}"]].set_axis(["t", "x", "y"], axis=1)
            is_seen = samples.notna().all(axis=1)
            parts.append(samples.assign(id=name, leader=leader)[is_seen])
            leader = np.where(is_seen, name, leader)  # of the cars behind, at each time
        yield (
            "platoons" if cars[0] == 1 else "platoons-unseen",
            path.stem,
            pd.concat(parts).sort_values("id", kind="stable"),
        )


def play(tracks: Tracks, detector: Any, seed: int) -> list[dict[str, Any]]:
    """A detector's answers to the windows that count; seconds are those of a window with the test of its leaders."""
    rows, number, start = [], 0, process_time()

    def score(section: Any, answer: Any, detected: Any) -> None:
        nonlocal number, start
        seconds, truth, window, links = process_time() - start, section.leader, section.window, detected.links
        everyone, index, roots = np.arange(window.uavs), section.ids.index, find_roots(truth)
        follows = (truth >= 0) & (truth != everyone)
        head = ~follows & np.isin(everyone, roots[follows])
        if follows.any() and window.velocity.any():
            confirmed = np.isin(section.ids, [leader.id for leader in detected.leaders])
            row = {"window": number, "step": section.step, "length": len(window.velocity), "uavs": len(everyone)}
            row |= {"heads": head.sum(), "followers": follows.sum(), "confirmed": confirmed.sum(), "links": len(links)}
            row |= {"named": answer.candidates.sum(), "named_right": (answer.candidates & head).sum()}
            row |= {"confirmed_right": (confirmed & head).sum(), "seconds": seconds}
            row["links_right"] = sum(truth[index(link.follower)] == index(link.leader) for link in links)
            row["direct"] = None if answer.leader is None else (answer.leader == truth)[follows].mean()
            rows.append(row)
        number, start = number + 1, process_time()

    length = tracks.choose_length()
    stride = max(length, -(-(round(tracks.duration / tracks.step) - length) // (MAX_WINDOWS - 1)))
    find_leaders(tracks, detector, length=length, stride=stride, seed=seed, on_window=score)
    return rows


def hash_weights(weights: Path = SHIPPED) -> str:
    """The first digits of the hash of a file of weights."""
    return sha256(weights.read_bytes()).hexdigest()[:8]


def report(rows: pd.DataFrame) -> str:
    """A table for each set; a recording is one value of a mean."""
    columns: dict[str, CellFormatter] = {"windows; recordings": lambda part: f"{len(part)}; {part.recording.nunique()}"}
    for named in ("named", "confirmed"):
        rows[f"{named}_alone"] = (rows[named] == rows.heads) & (rows[f"{named}_right"] == rows.heads)
        columns[f"{named}: the leader alone"] = mean_by_recording(f"{named}_alone")
        columns[f"{named}: right"] = share(f"{named}_right", named)
    columns |= {
        "direct links": mean_by_recording("direct"),
        "confirmed links: right": share("links_right", "links"),
    }
    columns["seconds"] = median("seconds")
    rows = rows.sort_values("detector", key=lambda names: names.map(DETECTORS.index), kind="stable")
    lines = {"detector": "detector", "weights": "weights"}
    return "\n\n".join(fold(title, pivot(rows[rows["set"] == name], lines, columns)) for name, title in TITLES.items())


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="holds the clones termites and platoons")
    parser.add_argument("--rows", type=Path, default=ROWS)
    parser.add_argument("--weights", type=Path, help="a file for the reader instead of the shipped one")
    parser.add_argument("--detector", action="append", help="may repeat; by default all of the table")
    options = parser.parse_args(argv)
    old = read_rows(options.rows) if options.rows.exists() else pd.DataFrame({"detector": [], "weights": []})
    shipped_hash, players, rows = hash_weights(options.weights or SHIPPED), {}, []
    for name in options.detector or DETECTORS:
        trained = name.startswith("reader") and "weights" not in name
        arguments = {"weights": str(options.weights)} if trained and options.weights else {}
        players[name, shipped_hash if trained else "–"] = make_detector(name, **arguments)
    for played in zip(old.detector, old.weights, strict=True):
        players.pop(played, None)
    for read, folder in ((read_termites, "termites"), (read_platoons, "platoons")):
        for kind, recording, samples in read(options.folder / folder) if players else ():
            tracks = read_tracks(samples).resample()
            for (name, weights), player in players.items():
                keys = {"set": kind, "recording": recording, "detector": name, "weights": weights}
                rows += [keys | row for row in play(tracks, player, crc32(recording.encode()))]
            print(kind, recording, f"{len(rows)} rows", flush=True)
    write_rows(options.rows, pd.DataFrame([*old.to_dict("records"), *rows]).round(4))


if __name__ == "__main__":
    main()
