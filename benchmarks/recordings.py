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
from pivot import fold, mean, median, pivot

from usnet_env import make_detector
from usnet_env.objectives import find_roots
from usnet_env.tracks import Tracks, find_leaders, read_tracks

ROWS = RESULTS / "recordings.csv.gz"
SHIPPED = ROOT / "detectors/reader/data/reader.safetensors"
DETECTORS = (
    "reader(policy='map')", "reader", "reader(weights='blind')", "reader(weights='untrained')", "lagged-network",
    "mflica", "front-most", "central-most", "track-outlier", "destroy-all", "random", "none",
)  # fmt: skip
MOST, LARGEST = 6, 2**22  # windows of a recording; bytes of a file
FRAMES, ARENA = 30, 145.0  # a second; mm that both animals together cross
APART = {"Rs": 7.0, "Cf": 10.0}  # mm, the size of an animal with its antennae
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
        wide, kind = pd.read_csv(path), path.relative_to(folder).parts[1]
        places = wide[["x0", "y0", "x1", "y1"]].to_numpy().reshape(-1, 2, 2)  # (T, animals, axes)
        places = (places - np.nanmin(places, axis=(0, 1))) * ARENA / np.ptp(places, axis=(0, 1))
        ids, parts = name_ids(path.stem, 2), []
        near = np.linalg.norm(places[:, 0] - places[:, 1], axis=1) <= APART[kind]
        for k, leader in enumerate(("", np.where(near, ids[0], ""))):
            x, y = places[:, k].T / 1000
            parts.append(pd.DataFrame({"id": ids[k], "t": wide["position"] / FRAMES, "x": x, "y": y, "leader": leader}))
        yield kind, path.stem, pd.concat(parts).sort_values("id", kind="stable")


def read_platoons(folder: Path) -> Iterator[Recording]:
    """The platoons; the number in the name of a column is the position of the car in the order."""
    for path in sorted(folder.glob("data/OpenACC_data/*/*_part*.csv")):
        if path.stat().st_size >= LARGEST:
            continue
        wide = pd.read_csv(path, skiprows=5)
        cars = sorted(int(name[1:]) for name in wide if re.fullmatch(r"E\d+", name))
        leader, parts = np.full(len(wide), "", object), []
        for car, name in zip(cars, name_ids(path.stem, len(cars)), strict=True):
            places = wide[["Time", f"E{car}", f"N{car}"]].set_axis(["t", "x", "y"], axis=1)
            seen = places.notna().all(axis=1)
            parts.append(places.assign(id=name, leader=leader)[seen])
            leader = np.where(seen, name, leader)  # of the cars behind, at each time
        yield (
            "platoons" if cars[0] == 1 else "platoons-unseen",
            path.stem,
            pd.concat(parts).sort_values("id", kind="stable"),
        )


def play(even: Tracks, detector: Any, seed: int) -> list[dict[str, Any]]:
    """A detector's answers to the windows that count; seconds are those of a window with the test of its leaders."""
    rows, number, since = [], 0, process_time()

    def score(cut: Any, answer: Any, found: Any) -> None:
        nonlocal number, since
        seconds, truth, everyone = process_time() - since, cut.leader, np.arange(cut.window.uavs)
        follows, roots = (truth >= 0) & (truth != everyone), find_roots(truth)
        head = ~follows & np.isin(everyone, roots[follows])
        if follows.any() and cut.window.velocity.any():
            of, sure = cut.ids.index, np.isin(cut.ids, [leader.id for leader in found.leaders])
            row = {"window": number, "step": cut.step, "length": len(cut.window.velocity), "uavs": len(everyone)}
            row |= {"heads": head.sum(), "followers": follows.sum(), "confirmed": sure.sum(), "links": len(found.links)}
            row |= {"named": answer.candidates.sum(), "named_right": (answer.candidates & head).sum()}
            row |= {"confirmed_right": (sure & head).sum(), "seconds": seconds}
            row["links_right"] = sum(truth[of(link.follower)] == of(link.leader) for link in found.links)
            row["direct"] = None if answer.leader is None else (answer.leader == truth)[follows].mean()
            rows.append(row)
        number, since = number + 1, process_time()

    length = even.choose_length()
    stride = max(length, -(-(round(even.duration / even.step) - length) // (MOST - 1)))
    find_leaders(even, detector, length=length, stride=stride, seed=seed, on_window=score)
    return rows


def edition(weights: Path = SHIPPED) -> str:
    """The first digits of the hash of a file of weights."""
    return sha256(weights.read_bytes()).hexdigest()[:8]


def report(rows: pd.DataFrame) -> str:
    """A table for each set; a recording is one value of a mean."""

    def mean_by_recording(metric: str) -> Any:
        return lambda part: mean(metric, group="recording")(part.groupby("recording", as_index=False)[metric].mean())

    def share(part: str, whole: str) -> Any:
        return lambda rows: f"{rows[part].sum() / rows[whole].sum():.1%}" if rows[whole].any() else "–"

    columns: dict[str, Any] = {"windows; recordings": lambda part: f"{len(part)}; {part.recording.nunique()}"}
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
    given = parser.parse_args(argv)
    old = read_rows(given.rows) if given.rows.exists() else pd.DataFrame({"detector": [], "weights": []})
    weights_hash, players, rows = edition(given.weights or SHIPPED), {}, []
    for name in given.detector or DETECTORS:
        trained = name.startswith("reader") and "weights" not in name
        how = {"weights": str(given.weights)} if trained and given.weights else {}
        players[name, weights_hash if trained else "–"] = make_detector(name, **how)
    for known in zip(old.detector, old.weights, strict=True):
        players.pop(known, None)
    for reads, folder in ((read_termites, "termites"), (read_platoons, "platoons")):
        for kind, recording, samples in reads(given.folder / folder) if players else ():
            even = read_tracks(samples).resample()
            for (name, weights), player in players.items():
                about = {"set": kind, "recording": recording, "detector": name, "weights": weights}
                rows += [about | row for row in play(even, player, crc32(recording.encode()))]
            print(kind, recording, f"{len(rows)} rows", flush=True)
    write_rows(given.rows, pd.DataFrame([*old.to_dict("records"), *rows]).round(4))


if __name__ == "__main__":
    main()
