"""What the detector thought, in a recording: its groups and leaders, probabilities, attention, features and scores."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from usnet_env.drawing import CLUSTER_COLORS, NO_CLUSTER_COLOR
from usnet_env.replay.episode import EpisodeRecord
from usnet_env.replay.scribe import MARK_COLORS, Scribe, lighten, parse_color
from usnet_env.replay.story import OTHER, rank_scores
from usnet_env.replay.world import MOST_LABELS, RING, SMALL

FOUND, ATTENTION, FEATURES, SCORES = "world/found", "mind/attention", "mind/features", "scores"
CHART_WIDTH, CHART_HEIGHT = 8.0, 1.0  # of the bars, in the units of their view
_NAMED, _TEXT, _LINK = "#35A7FF", "#C8C8C8", "#FFFFFF"
_LINKS_OF_A_UAV = 2  # its largest weights of attention
_MOST_PIXELS = 256  # the side of a heat map; larger matrices are reduced to the largest weights
_MAP_GAP, _MAPS_IN_A_ROW = 1.35, 3  # distance of neighbouring heat maps, in their sides
_ONE_ROW = 20  # with more bars, the numbers below them take turns in two rows


def find_groups(record: EpisodeRecord, r: int) -> NDArray[np.int64]:
    """``(N,)``: the found group of each UAV in round ``r`` (from 0): its cluster, or else its leader; -1: none."""
    alive = record.alive[r]
    if record.clusters is not None and (record.clusters[r][alive] >= 0).any():
        values = np.where(alive, record.clusters[r], -1)
    elif record.leader_estimate is not None:
        leader = record.leader_estimate[r].copy()
        leader[record.candidates[r]] = np.flatnonzero(record.candidates[r])
        values = np.where(alive, leader, -1)
    else:
        return np.full(record.uavs, -1)
    labels, index, counts = np.unique(values, return_inverse=True, return_counts=True)
    kept = np.flatnonzero((labels >= 0) & (counts > 1))
    number = np.full(len(labels), -1)
    number[kept[np.argsort(-counts[kept], kind="stable")]] = np.arange(len(kept))
    return number[index]


def _group_colors(groups: NDArray[np.int64]) -> NDArray[np.uint8]:
    """``(N, 4)``: colours of the detector's groups; they have nothing to do with those of the true clusters."""
    words = [CLUSTER_COLORS[g % len(CLUSTER_COLORS)] if g >= 0 else NO_CLUSTER_COLOR for g in groups.tolist()]
    return lighten(words)


def _strengths(record: EpisodeRecord, r: int) -> NDArray[np.float64]:
    """``(N,)``, from 0 to 1: the probabilities of round ``r``, or else its scores in relation to the highest."""
    if record.probability is not None:
        return record.probability[r]
    scores = np.maximum(record.scores[r], 0)
    return scores / max(float(scores.max()), np.finfo(float).tiny)


def write_mind(scribe: Scribe) -> None:
    """Write all of it; each part appears with the answer, and vanishes when the next round begins."""
    _write_found(scribe)
    if scribe.record.attention is not None:
        _write_attention(scribe, scribe.record.attention)
        _write_maps(scribe)
        _write_waiting(scribe, ATTENTION, (scribe.record.uavs / 2, scribe.record.uavs / 2))
    if scribe.record.features is not None:
        _write_features(scribe, scribe.record.features)
        _write_waiting(scribe, FEATURES, (0.0, 0.0))
    _write_scores(scribe)
    _write_waiting(scribe, SCORES, (CHART_WIDTH / 2, -CHART_HEIGHT / 2))


def _write_waiting(scribe: Scribe, path: str, place: tuple[float, float]) -> None:
    """Write into a view that it is empty because the detector has not answered yet."""
    rounds = scribe.record.rounds
    rows = scribe.clock.list_rows([0, scribe.clock.answer])
    look = {"radii": [0.001], "show_labels": True, "colors": [parse_color(_TEXT)]}
    words = {"positions": [place] * rounds, "labels": ["no answer yet"] * rounds}
    scribe.send(f"{path}/waiting", scribe.rr.Points2D, rows, [1, 0] * rounds, look, **words)


def _write_found(scribe: Scribe) -> None:
    """Write all living UAVs in the colour of their found group, as large as probable, and the candidates."""
    record, rr = scribe.record, scribe.rr
    word, values = ("score", record.scores) if record.probability is None else ("p", record.probability)
    points, rings, labels, links = [], [], [], []
    for r in range(record.rounds):
        place, groups = scribe.last[r], find_groups(record, r)
        seen = np.isfinite(place[:, 0])
        living = np.flatnonzero(record.alive[r] & seen)
        colors, sure = _group_colors(groups), _strengths(record, r)
        radii = SMALL * scribe.scale * (0.9 + 1.8 * sure[living])
        words = [f"UAV {scribe.names[i]}: {word} {values[r, i]:.3g}" for i in living]
        points.append({"positions": place[living], "colors": colors[living], "radii": radii, "labels": words})
        named = np.flatnonzero(record.candidates[r] & seen)
        half = np.full((len(named), 3), RING * scribe.scale, np.float32)
        rings.append({"centers": place[named], "half_sizes": half})
        above = place[named] + np.array([0, 0, 1.6 * RING * scribe.scale], np.float32)
        texts = [scribe.names[i] + ("" if record.probability is None else f", p {sure[i]:.2f}") for i in named]
        few = len(named) if len(named) <= MOST_LABELS else 0
        labels.append({"positions": above[:few], "labels": texts[:few]})
        pairs = record.hierarchy(r + 1)
        pairs = np.zeros((0, 2), np.int64) if pairs is None else pairs[seen[pairs].all(axis=1)]
        faint = colors[pairs[:, 0]] * np.array([1, 1, 1, 0.35])
        links.append({"strips": place[pairs], "colors": faint.astype(np.uint8)})
    scribe.show_with_answer(f"{FOUND}/uavs", rr.Points3D, points, {"show_labels": False})
    frame = [rr.components.FillMode.MajorWireframe]
    look = {"colors": [parse_color(_NAMED)], "line_radii": [0.7 * scribe.scale], "fill_mode": frame}
    scribe.show_with_answer(f"{FOUND}/candidates", rr.Ellipsoids3D, rings, look)
    look = {"radii": [0.1], "colors": [parse_color(_NAMED)], "show_labels": True}
    scribe.show_with_answer(f"{FOUND}/labels", rr.Points3D, labels, look)
    scribe.show_with_answer(f"{FOUND}/links", rr.LineStrips3D, links, {"radii": [0.6 * scribe.scale]})


def _write_attention(scribe: Scribe, attention: NDArray[np.float32]) -> None:
    """Write the largest weights of each UAV as lines, as wide as the weight."""
    values = []
    for r, weights in enumerate(attention):
        place = scribe.last[r]
        usable = scribe.record.alive[r] & np.isfinite(place[:, 0])
        off = np.where(usable[:, None] & usable & ~np.eye(len(usable), dtype=bool), weights, 0.0)
        most = np.argsort(-off, axis=1, kind="stable")[:, :_LINKS_OF_A_UAV]
        row = np.repeat(np.arange(len(off)), most.shape[1])
        pairs = np.stack([row, most.ravel()], axis=1)
        weight = off[pairs[:, 0], pairs[:, 1]]
        kept = weight > 0.05 * max(float(weight.max(initial=0)), 1e-12)
        share = weight[kept] / max(float(weight.max(initial=0)), 1e-12)
        color = np.column_stack([np.tile(parse_color(_LINK)[:3], (len(share), 1)), 20 + 90 * share]).astype(np.uint8)
        values.append({"strips": place[pairs[kept]], "radii": (0.2 + 1.6 * share) * scribe.scale, "colors": color})
    scribe.show_with_answer(f"{FOUND}/attention", scribe.rr.LineStrips3D, values)


def _reduce(matrix: NDArray[np.float32]) -> NDArray[np.float32]:
    """A matrix of at most 256 rows and columns, each value the largest of a block."""
    factor = -(-len(matrix) // _MOST_PIXELS)
    if factor == 1:
        return matrix
    size = -(-len(matrix) // factor)
    padded = np.zeros((size * factor,) * 2, np.float32)
    padded[: len(matrix), : len(matrix)] = matrix
    return padded.reshape(size, factor, size, factor).max(axis=(1, 3))


def attention_maps(record: EpisodeRecord, r: int) -> list[tuple[str, NDArray[np.float32]]]:
    """The heat maps of round ``r`` (from 0) with their titles: all weights, then those of each attention head.

    Rows and columns are the living UAVs, sorted by their found group, so that groups are blocks on the diagonal.
    """
    assert record.attention is not None
    order = np.flatnonzero(record.alive[r])
    groups = find_groups(record, r)[order]
    order = order[np.lexsort((order, ~record.candidates[r][order], np.where(groups < 0, len(order), groups)))]
    maps = [("all weights", record.attention[r])]
    if record.attention_heads is not None:
        maps += [(f"attention head {h + 1}", each) for h, each in enumerate(record.attention_heads[r])]
    return [(title, _reduce(values[np.ix_(order, order)])) for title, values in maps]


def place_maps(count: int, side: int) -> tuple[list[tuple[int, int]], tuple[int, int]]:
    """Row and column of the first pixel of each of ``count`` square maps, and the shape of their sheet."""
    step, across = max(round(side * _MAP_GAP), side + 1), min(count, _MAPS_IN_A_ROW)
    places = [(k // across * step, k % across * step) for k in range(count)]
    return places, (places[-1][0] + side, step * across - step + side)


def _write_maps(scribe: Scribe) -> None:
    """Write the heat maps of attention, brighter for larger weights in relation to the largest one of the UAV.

    The weights of a UAV sum to 1 within its cluster: those of small clusters are larger than those of large ones.
    """
    rr = scribe.rr
    for r in range(scribe.record.rounds):
        maps = attention_maps(scribe.record, r)
        side = len(maps[0][1])
        places, shape = place_maps(len(maps), side)
        sheet = np.full((*shape, 3), parse_color("#101418")[:3], np.uint8)
        for (y, x), (_, values) in zip(places, maps, strict=True):
            share = np.clip(values / np.maximum(values.max(axis=1, keepdims=True), 1e-12), 0, 1)[..., None]
            sheet[y : y + side, x : x + side] = 20 + share * (np.array([255, 236, 120]) - 20)
        titles = rr.Points2D(
            [[x + 0.5 * side, y - 0.17 * side] for y, x in places], labels=[title for title, _ in maps],
            colors=parse_color(_TEXT), radii=0.01, show_labels=True,
        )  # fmt: skip
        for part in ("maps", "titles"):
            scribe.log_at(f"{ATTENTION}/{part}", r, 0, rr.Clear(recursive=False))
        scribe.log_at(f"{ATTENTION}/maps", r, scribe.clock.answer, rr.Image(sheet))
        scribe.log_at(f"{ATTENTION}/titles", r, scribe.clock.answer, titles)


def _write_features(scribe: Scribe, features: NDArray[np.float32]) -> None:
    """Write the feature space of each round, candidates large, in the colours of the found groups."""
    values = []
    for r, plane in enumerate(features):
        living = np.flatnonzero(scribe.record.alive[r])
        size = 2 * max(float(np.abs(plane[living]).max(initial=0)), 1e-12)
        values.append(
            {
                "positions": (plane[living] / size).astype(np.float32),
                "colors": _group_colors(find_groups(scribe.record, r))[living],
                "radii": np.where(scribe.record.candidates[r][living], 0.022, 0.01),
                "labels": [f"UAV {scribe.names[i]}" for i in living],
            }
        )
    scribe.show_with_answer(FEATURES, scribe.rr.Points2D, values, {"show_labels": False})


def _write_scores(scribe: Scribe) -> None:
    """Write the scores of each round as bars, highest first, with the numbers of candidates and heads below."""
    record, rr = scribe.record, scribe.rr
    bars: list[dict[str, Any]] = []
    numbers: list[dict[str, Any]] = []
    titles: list[dict[str, Any]] = []
    for r, marks in enumerate(scribe.marks):
        order = rank_scores(record, r + 1)
        scores, words = record.scores[r, order], marks[order]
        top = max(float(np.abs(scores).max(initial=0)), np.finfo(float).tiny)
        height, step = scores / top * CHART_HEIGHT, CHART_WIDTH / max(len(order), 1)
        colors = np.array([parse_color(MARK_COLORS[word]) for word in words], np.uint8).reshape(-1, 4)
        left = step * np.arange(len(order))
        # y grows downwards; a thin base shows the UAVs whose score is 0, too.
        half = np.stack([np.full(len(order), 0.4 * step), (np.abs(height) + 0.03) / 2], axis=1)
        corner = np.stack([left, np.minimum(-height, 0)], axis=1)
        labels = [
            f"UAV {scribe.names[i]}: score {score:.3g}, {word}"
            for i, score, word in zip(order, scores, words, strict=True)
        ]
        bars.append({"centers": corner + half, "half_sizes": half, "colors": colors, "labels": labels})
        named = np.flatnonzero(words != OTHER)
        named = named if len(named) <= MOST_LABELS else named[:0]
        below = (
            max(float(-height.min(initial=0)), 0) + 0.18 + 0.22 * (np.arange(len(named)) % 2) * (len(order) > _ONE_ROW)
        )
        names = [scribe.names[i] for i in order[named]]
        numbers.append(
            {"positions": np.stack([left[named] + 0.4 * step, below], axis=1), "colors": colors[named], "labels": names}
        )
        scale = f"highest score {scores.max():.3g}" if scores.any() else "all scores are 0"
        titles.append({"positions": np.array([[0.8 * CHART_WIDTH, -1.2]]), "labels": [scale]})
    text = {"radii": [0.001], "show_labels": True}
    scribe.show_with_answer(f"{SCORES}/bars", rr.Boxes2D, bars, {"show_labels": False})
    scribe.show_with_answer(f"{SCORES}/numbers", rr.Points2D, numbers, text)
    scribe.show_with_answer(f"{SCORES}/scale", rr.Points2D, titles, {**text, "colors": [parse_color(_TEXT)]})
