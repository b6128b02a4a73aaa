"""The tables of the paper's algorithms, beside what the paper says: P1, P2, purity."""

from __future__ import annotations

from functools import cache, partial
from pathlib import Path

import numpy as np
import pandas as pd
from paper.shared import RESULTS, STUDIES, TITLES, read_rows
from pivot import CellFormatter, across, fold, markdown, mean, median, pivot, rate, size

from usnet_env.evaluation import TRIVIAL

DATA = Path(__file__).parent / "paper" / "data"
DECOYS = (("no decoy", 0), ("one decoy", 1))
SMALL = (2, 5)  # followers of the clusters of short tables
LEARNING = {  # what is learned, by detector
    "gassl(steps=0)": "attention to contents, untrained",
    "gassl": "the same, trained",
    "neural-granger(steps=1)": "attention to predictions, one step of training",
    "neural-granger": "the same, trained",
    "neural-granger(input_noise=0)": "trained without noise on the past",
    "neural-granger(weight_decay=0)": "trained without decay of weights",
    "neural-granger(ridge=1e9)": "trained without a model of a UAV's own past",
    "lagged-regression(clusters=1)": "predictions alone, no network and no attention",
    "reader(policy='map')": "who leads, from simulated swarms",
    "track-outlier(threshold=1000)": "nothing, each track alone",
    "central-most(reach=100)": "nothing, the places at one instant",
}
ALGORITHMS = {  # the detectors of P1 and of P2, by the words of their line
    "`gassl` and `mc-gassl`, as printed": ("gassl", "mc-gassl"),
    "the same, untrained (`steps=0`)": ("gassl(steps=0)", "mc-gassl(gassl={'steps': 0})"),
    "`track-outlier`, each track alone": ("track-outlier(threshold=1000)", "track-outlier"),
    "`central-most`, the places at one instant": ("central-most(reach=100)", "central-most"),
    "`reader`": ("reader(policy='map')", "reader"),
}


@cache
def read_table2() -> pd.DataFrame:
    """The rows of P1, with the paper's 1,000 runs of each cell as rows of the detector ``the paper``."""
    cells = pd.read_csv(DATA / "table2_detection_rate.csv").rename(columns={"ifs": "follow"})
    paper = cells.loc[cells.index.repeat(1000)].assign(episode=np.arange(1000 * len(cells)))  # independent runs
    paper["hit"] = (paper.episode % 1000 < (10 * paper.detection_rate_percent).round()).astype(int)
    paper = paper.assign(detector="the paper", decoys=0, mobility="iid", head_jitter=False)
    rows = pd.concat([paper, read_rows(RESULTS / "paper" / "table2.csv.gz")])
    heads = rows.mobility + np.where(rows.head_jitter, " with jitter", "")
    rows = rows.assign(heads=heads, chance=1 / (rows.followers + 1 + rows.decoys), flown=rows.mobility != "iid")
    return rows.sort_values(["flown", "head_jitter", "decoys"], kind="stable")


def table2_block() -> str:
    """Table II beside ours, and all settings of heads and decoys over all cells."""
    rows = read_table2()
    overview = pivot(
        rows,
        {"detector": "detector", "heads": "heads", "decoys": "decoys"},
        {
            "cells": lambda part: str(len(part.groupby(["follow", "followers"]))),
            "n": size,
            "head alone named": rate("hit"),
            "mean of cells": lambda part: f"{100 * _cell_rates(part).mean():.1f} %",
            "lowest cell": lambda part: f"{100 * _cell_rates(part).min():.1f} %",
            "one UAV at random": lambda part: f"{100 * part.chance.mean():.1f} %",
        },
    )
    chosen = rows[(rows.heads == "iid") & (rows.decoys == 0)].sort_values("follow", kind="stable")
    columns = across("followers", sorted(set(chosen.followers)), _short_rate, "m={}")
    return f"{overview}\n\n{pivot(chosen, {'f': 'follow', 'detector': 'detector'}, columns)}"


def learning_block() -> str:
    """What of the rates of small clusters comes from attention and its training, in ever harder settings."""
    rows = read_table2()
    rows = rows[rows.detector.isin(list(LEARNING))]
    settings = {f"{name}, m = 2 and 5": ("iid", decoys, SMALL) for name, decoys in DECOYS}
    settings["one decoy, heads fly to waypoints, m = 2"] = ("waypoint with jitter", 1, (2,))
    names = rows.detector.map(list(LEARNING).index)
    rows = rows.assign(learns=rows.detector.map(LEARNING)).iloc[names.argsort(kind="stable")]
    columns = {f"{name}; n": partial(_format_hits, setting=setting) for name, setting in settings.items()}
    return pivot(rows, {"detector": "detector", "what it learns": "learns"}, columns)


def _format_hits(rows: pd.DataFrame, setting: tuple[str, int, tuple[int, ...]]) -> str:
    heads, decoys, followers = setting
    part = rows[(rows.heads == heads) & (rows.decoys == decoys) & rows.followers.isin(followers)]
    return rate("hit", count=True)(part)


def _cell_rates(rows: pd.DataFrame) -> pd.Series:
    return rows.groupby(["follow", "followers"]).hit.mean()


def _short_rate(rows: pd.DataFrame) -> str:
    return f"{100 * rows.hit.mean():.1f}" if len(rows) else ""


@cache
def read_rounds() -> pd.DataFrame:
    """The rows of P2 with the paper's heads, trivial policies last."""
    rows = read_rows(RESULTS / "paper" / "rounds.csv.gz")
    rows = rows[~rows.detector.isin(["none", "one-per-round"])]  # every game of theirs ends alike
    return rows.sort_values("detector", key=lambda names: names.isin(TRIVIAL).astype(str) + names, kind="stable")


def rounds_block() -> str:
    """A table for each study of P2, below what the paper says."""
    rows, parts = read_rounds(), []
    columns: dict[str, CellFormatter] = {
        "n": size,
        "rounds": mean("rounds"),
        "redundant, % of N": mean("redundancy", 2, 100),
        "J_m": mean("J"),
        "exact": rate("exact"),
    }
    words = pd.read_csv(DATA / "multi_cluster_in_words.csv", index_col="study").words
    headings = {"follow": ("f", "follow"), "clusters": ("M", "clusters")}
    for study, swarms in STUDIES.items():
        heading, column = headings.get(study, ("N", "uavs"))
        study_rows = rows[rows[list(swarms)].isin(swarms).all(axis=1)].sort_values(column, kind="stable")
        table = pivot(study_rows, {heading: column, "detector": "detector"}, columns)
        extra = [_found_by_round(rows[rows.uavs == 185])] if study == "example" else []
        parts.append(fold(TITLES[study], f"The paper, in words: {words[study]}.", table, *extra))
    return "\n\n".join(parts)


def _found_by_round(rows: pd.DataFrame) -> str:
    """Candidates of each round of the example, and heads found until then."""
    named, hits = (
        rows[name].astype(str).str.split(expand=True).fillna(0).astype(int).reindex(columns=range(4), fill_value=0)
        for name in ("named", "hits")
    )
    found_share = 100 * hits.cumsum(axis=1) / 8

    def format_cell(part: pd.DataFrame, number: int) -> str:
        return f"{named.loc[part.index, number].mean():.1f} / {found_share.loc[part.index, number].mean():.0f}"

    columns: dict[str, CellFormatter] = {
        f"round {number + 1}": partial(format_cell, number=number) for number in range(4)
    }
    about = "Candidates of a round / share of the 8 heads found until then, %; the paper has 8 / 75 and 2 / 100:"
    return f"{about}\n\n{pivot(rows, {'detector': 'detector'}, {'n': size, **columns})}"


def purity_block() -> str:
    """Purity of every clusterer over f1 to f7."""
    columns: dict[str, CellFormatter] = {
        "n": size,
        "clusters found": mean("found", 1),
        "purity": mean("purity"),
        "head-in-cluster": mean("head_in_cluster"),
        "seconds": median("seconds"),
    }
    rows = read_rows(RESULTS / "paper" / "purity.csv.gz")
    rows = rows.sort_values("count", key=lambda counts: counts != "given", kind="stable")
    return pivot(rows, {"clusterer": "clusterer", "M": "count", "features": "features"}, columns)


def paper_algorithms() -> str:
    """The paper's algorithms and what knows less than they do, beside the paper's own numbers."""
    rows, games = read_table2(), read_rounds()
    cells = {name: rows[(rows.heads == "iid") & (rows.decoys == decoys)] for name, decoys in DECOYS}
    games = games[(games.clusters == 5) & (games.uavs == 82)]
    words = pd.read_csv(DATA / "multi_cluster_in_words.csv", index_col="study").loc["follow"]

    def hits(name: str) -> list[str]:
        parts = [part[part.detector == name] for part in cells.values()]
        return [f"{100 * _cell_rates(part).mean():.1f}; {len(part):,}" if len(part) else "–" for part in parts]

    def cost(name: str) -> str:
        part = games[games.detector == name]
        return f"{mean('J')(part)}; {len(part)}"

    lowest, highest = (words[f"rounds_{end}"] + words[f"redundant_{end}"] / 82 for end in ("low", "high"))
    uavs = rows.followers.unique() + 1
    chance = [f"{100 * (1 / (uavs + decoys)).mean():.1f}, computed" for _, decoys in DECOYS]
    body = [["the paper", *hits("the paper"), f"{lowest:.2f}–{highest:.2f}; –"]]
    body += [[line, *hits(single), cost(several)] for line, (single, several) in ALGORITHMS.items()]
    body += [["`random`, one UAV a round", *chance, cost("random")]]
    body += [["`destroy-all`", "0, computed", "0, computed", cost("destroy-all")]]
    names = [f"P1, 70 cells, {name}: head alone named, %" for name in cells]
    return markdown(("the paper's algorithms", *names, "P2, M = 5, N = 82: J_m"), body)
