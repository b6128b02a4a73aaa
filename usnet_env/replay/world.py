"""The swarm of a recording in 3-D: UAVs, tracks, links, the ground, and the marks of hits and missed heads."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from usnet_env.drawing import cluster_colors
from usnet_env.replay.episode import EpisodeRecord
from usnet_env.replay.scribe import MARK_COLORS, Scribe, lighten, parse_color
from usnet_env.replay.story import MISSED, OTHER, REDUNDANT, name_uav

WORLD = "world"
SWARM, VERDICT, OBSERVERS = f"{WORLD}/swarm", f"{WORLD}/verdict", f"{WORLD}/observers"
SMALL, LARGE, RING = 6.0, 14.0, 30.0  # metres: radii of a follower, of a head, and of the mark of a candidate
MOST_LABELS = 16  # in a round with more marks, the labels are left out, and the text says so
_DESTROYED, _DECOY, _ORPHAN, _GROUND, _OBSERVER = "#8A8A8A", "#FFE45C", "#9A9A9A", "#39424C", "#7CC7FF"
_SCALE = "#AAB4BE"
_MOST_VERTICES = 1_200_000  # of all growing tracks: 14 MB
_DIAMOND = np.array(
    [[0, 0, 1], [1, 0, 0], [0, 0, -1], [-1, 0, 0], [0, 0, 1], [0, 1, 0], [0, 0, -1], [0, -1, 0], [0, 0, 1]], np.float32
)
_CROSS = np.array([[[-1, -1, 0], [1, 1, 0]], [[-1, 1, 0], [1, -1, 0]]], np.float32)


def write_world(scribe: Scribe) -> None:
    """Write all of it."""
    record = scribe.record
    scribe.stream.log(scribe.root + WORLD, scribe.rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    middles = np.array([(low + high) / 2 for low, high in scribe.boxes], np.float32)
    # The middle of each round is moved to the origin, so that a fixed camera has all rounds in view.
    scribe.send(WORLD, scribe.rr.Transform3D, scribe.clock.list_rows([0]), 1, translation=-middles)
    _write_ground(scribe)
    decoys = record.decoys
    _write_points(scribe, f"{SWARM}/followers", ~record.head & ~decoys, SMALL)
    _write_points(scribe, f"{SWARM}/heads", record.head & np.ones_like(decoys), LARGE)
    if decoys.any():
        _write_decoys(scribe, decoys)
    filled = np.stack([_fill_gaps(*each) for each in zip(record.position, record.seen, strict=True)])
    stages, points = _choose_stages(scribe)
    _write_tracks(scribe, filled, stages, points)
    _write_links(scribe, filled, stages)
    if not record.recorded:
        _write_destroyed(scribe)
    _write_marks(scribe)
    if record.observers is not None:
        _write_observers(scribe, record.observers)


def choose_spacing(span: float) -> float:
    """A round number of metres, about an eighth of ``span``: 1, 2 or 5 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(span / 8))
    return float(power * max(factor for factor in (1, 2, 5) if factor * power <= span / 8))


def _write_ground(scribe: Scribe) -> None:
    low = np.min([each for each, _ in scribe.boxes], axis=0)
    high = np.max([each for _, each in scribe.boxes], axis=0)
    spacing = choose_spacing(max(scribe.span, float((high - low)[:2].max()) / 6))
    ends = zip(np.floor(low[:2] / spacing), np.ceil(high[:2] / spacing), strict=True)
    x, y = (np.arange(first, last + 1) * spacing for first, last in ends)
    z = float(low[2]) - 0.02 * scribe.span
    lines = [[[at, y[0], z], [at, y[-1], z]] for at in x] + [[[x[0], at, z], [x[-1], at, z]] for at in y]
    look = {"colors": [parse_color(_GROUND)], "radii": [0.7 * scribe.scale]}
    shape = scribe.rr.LineStrips3D.from_fields(strips=np.array(lines, np.float32), **look)
    scribe.stream.log(f"{scribe.root}{WORLD}/ground", shape, static=True)
    # The label is at the edge that is near to the camera, which follows the middle of each round.
    edges = [[(below[0] + above[0]) / 2, below[1] - 0.06 * scribe.span, z] for below, above in scribe.boxes]
    words = [f"grid of {spacing:g} m"]
    label = {"labels": words, "colors": [parse_color(_SCALE)], "radii": [0.001], "show_labels": True}
    rows = scribe.clock.list_rows([0])
    scribe.send(f"{WORLD}/ground/scale", scribe.rr.Points3D, rows, 1, label, positions=edges)


def _list_colors(record: EpisodeRecord, alpha: int) -> NDArray[np.uint8]:
    """``(R, 3, N, 4)``: the colours of all UAVs in the window, after the destruction and after the re-merge."""
    colors = np.stack([lighten(cluster_colors(record.head, root)[0], alpha) for root in record.root])
    grey = np.where(record.orphans[..., None], lighten([_ORPHAN], alpha), colors)
    remerged = np.concatenate([colors[1:], colors[-1:]])
    return np.stack([colors, grey, remerged], axis=1)


def _write_points(scribe: Scribe, path: str, who: NDArray[np.bool_], radius: float) -> None:
    """Write the UAVs ``who`` ``(R, N)`` as points in the colour of their cluster."""
    record, clock = scribe.record, scribe.clock
    members = np.flatnonzero(who.any(axis=0))
    if not len(members):
        return
    shown = record.seen & (record.alive & who)[:, None]
    place = np.where(shown[..., None], record.position, np.float32(np.nan))[:, :, members]
    left = (record.alive & who & ~record.destroyed)[:, members, None]
    after = np.where(left, scribe.last[:, members], np.float32(np.nan))[:, None]
    rows = clock.list_rows([*range(clock.samples), clock.destroy])
    every = np.concatenate([place, after], axis=1).reshape(-1, 3)
    look = {
        "radii": [radius * scribe.scale],
        "labels": [name_uav(record, i) for i in members.tolist()],
        "show_labels": False,
    }
    scribe.send(path, scribe.rr.Points3D, rows, len(members), look, positions=every)
    _send_colors(scribe, path, scribe.rr.Points3D, members, 255)


def _send_colors(scribe: Scribe, path: str, kind: object, members: NDArray[np.intp], alpha: int) -> None:
    """Write the colours of an entity with one instance for each member, as they change in the course of a round."""
    rows = scribe.clock.list_rows([0, scribe.clock.destroy, scribe.clock.remerge])
    colors = _list_colors(scribe.record, alpha)[:, :, members].reshape(-1, 4)
    scribe.send(path, kind, rows, len(members), colors=colors)


def _fill_gaps(place: NDArray[np.float32], seen: NDArray[np.bool_]) -> NDArray[np.float32]:
    """``(T_ob + 1, N, 3)``: the latest position that was seen, the first one before it; NaN for a UAV never seen."""
    instants = np.arange(len(seen))[:, None]
    latest = np.maximum.accumulate(np.where(seen, instants, -1), axis=0)
    index = np.where(latest >= 0, latest, np.argmax(seen, axis=0))
    filled = np.take_along_axis(place, index[..., None], axis=0)
    return np.where(np.any(seen, axis=0, keepdims=True).T, filled, np.float32(np.nan))


def _choose_stages(scribe: Scribe) -> tuple[list[int], int]:
    """The instants at which tracks and links are drawn anew, and the largest number of points of a track."""
    samples, strips = scribe.clock.samples, scribe.record.rounds * scribe.record.uavs
    for points in (samples, 41, 25, 13):
        for count in (samples - 1, 32, 16, 8, 4):
            ends = np.unique(np.linspace(samples - 1, 0, min(count, samples - 1), endpoint=False).round().astype(int))
            if strips * np.minimum(ends + 1, points).sum() <= _MOST_VERTICES:
                return ends.tolist(), points
    return ends.tolist(), points


def _write_tracks(scribe: Scribe, filled: NDArray[np.float32], stages: list[int], points: int) -> None:
    """Write the tracks ``filled`` ``(R, T_ob + 1, N, 3)``, which grow behind the UAVs from stage to stage."""
    record, path = scribe.record, f"{SWARM}/tracks"
    strips, list_rows = scribe.rr.LineStrips3D, scribe.clock.list_rows
    look = {"radii": [0.9 * scribe.scale]}
    scribe.send(path, strips, list_rows([0]), 0, look, strips=np.zeros((0, 2, 3), np.float32))
    for end in stages:
        kept = np.unique(np.linspace(0, end, min(end + 1, points)).round().astype(int))
        grown = np.swapaxes(filled[:, kept], 1, 2).reshape(-1, len(kept), 3)
        scribe.send(path, strips, list_rows([end]), record.uavs, strips=grown)
    _send_colors(scribe, path, strips, np.arange(record.uavs), 150)


def _write_links(scribe: Scribe, filled: NDArray[np.float32], stages: list[int]) -> None:
    """Write the communication links, faint lines from followers to their heads."""
    record, clock = scribe.record, scribe.clock
    members = np.flatnonzero(~record.head)
    decoys, orphans = record.decoys, record.orphans
    strips = []
    for r in range(record.rounds):
        root = record.root[r]
        linked = record.alive[r] & ~decoys[r] & (root >= 0)
        left = linked & ~record.destroyed[r] & ~orphans[r]
        new = record.root[r + 1] if r + 1 < record.rounds else root
        merged = linked & ~record.destroyed[r] & (new >= 0) & ~record.destroyed[r][new]
        drawn = [(filled[r, i], linked, root) for i in (0, *stages)]
        drawn += [(scribe.last[r], left, root), (scribe.last[r], merged, new)]
        for at, who, behind in drawn:
            ends = np.stack([at[members], at[behind[members]]], axis=1)
            strips.append(np.where(who[members, None, None], ends, np.float32(np.nan)))
    kind, path = scribe.rr.LineStrips3D, f"{SWARM}/links"
    rows = clock.list_rows([0, *stages, clock.destroy, clock.remerge])
    look = {"radii": [0.5 * scribe.scale]}
    scribe.send(path, kind, rows, len(members), look, strips=np.concatenate(strips))
    _send_colors(scribe, path, kind, members, 70)


def _write_decoys(scribe: Scribe, decoys: NDArray[np.bool_]) -> None:
    """Write the decoys as diamonds."""
    record = scribe.record
    members = np.flatnonzero(decoys.any(axis=0))
    shown = record.seen & decoys[:, None]
    place = np.where(shown[..., None], record.position, np.float32(np.nan))[:, :, members].reshape(-1, 1, 3)
    rows = scribe.clock.list_rows(range(scribe.clock.samples))
    strips = place + 1.4 * LARGE * np.float32(scribe.scale) * _DIAMOND
    look = {"radii": [1.6 * scribe.scale], "colors": [parse_color(_DECOY)]}
    scribe.send(f"{SWARM}/decoys", scribe.rr.LineStrips3D, rows, len(members), look, strips=strips)


def _write_destroyed(scribe: Scribe) -> None:
    """Write the destroyed UAVs as crosses where they were seen last, from the moment of their destruction."""
    record, clock = scribe.record, scribe.clock
    strips, lengths = [], []
    for r in range(record.rounds):
        place = record.last_position(r + 1)
        for gone in (~record.alive[r], ~record.alive[r] | record.destroyed[r]):
            at = place[gone & np.isfinite(place[:, 0])]
            lengths.append(2 * len(at))
            strips.append((at[:, None, None] + 1.8 * SMALL * np.float32(scribe.scale) * _CROSS).reshape(-1, 2, 3))
    rows = clock.list_rows([0, clock.destroy])
    look = {"radii": [1.4 * scribe.scale], "colors": [parse_color(_DESTROYED)]}
    scribe.send(f"{SWARM}/destroyed", scribe.rr.LineStrips3D, rows, lengths, look, strips=np.concatenate(strips))


def _write_marks(scribe: Scribe) -> None:
    """Write a wire sphere around hits and missed heads, a box around redundant candidates, and their labels."""
    rr = scribe.rr
    seen = np.isfinite(scribe.last[..., 0])
    words = list(dict.fromkeys(word for marks in scribe.marks for word in marks if word != OTHER))
    for word in words:
        kind = rr.Boxes3D if word == REDUNDANT else rr.Ellipsoids3D
        values = []
        for r, marks in enumerate(scribe.marks):
            who = (marks == word) & seen[r]
            half = np.full((int(who.sum()), 3), scribe.scale * RING * (0.8 if word == REDUNDANT else 1.0), np.float32)
            values.append({"centers": scribe.last[r][who], "half_sizes": half})
        width = {"radii" if word == REDUNDANT else "line_radii": [0.7 * scribe.scale * (0.5 if word == MISSED else 1)]}
        frame = [rr.components.FillMode.MajorWireframe]
        look = {"colors": [parse_color(MARK_COLORS[word])], "fill_mode": frame, **width}
        scribe.show_with_answer(f"{VERDICT}/{word}", kind, values, look)
    labels = []
    for r, marks in enumerate(scribe.marks):
        who = np.flatnonzero((marks != OTHER) & seen[r])
        who = who if len(who) <= MOST_LABELS else who[:0]
        labels.append(
            {
                "positions": scribe.last[r][who] + np.array([0, 0, 1.6 * RING * scribe.scale], np.float32),
                "colors": np.array([parse_color(MARK_COLORS[marks[i]]) for i in who], np.uint8).reshape(-1, 4),
                "labels": [f"{marks[i]} {scribe.names[i]}" for i in who],
            }
        )
    scribe.show_with_answer(f"{VERDICT}/labels", rr.Points3D, labels, {"radii": [0.1], "show_labels": True})


def _write_observers(scribe: Scribe, observers: NDArray[np.float64]) -> None:
    """Write the places of the observers, with a circle of their sensing range."""
    angle = np.linspace(0, 2 * np.pi, 65)
    circle = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    rings = (observers[:, None, :3] + observers[:, None, 3:] * circle).astype(np.float32)
    color = parse_color(_OBSERVER)
    names = [f"observer {k}, range {each[3]:g} m" for k, each in enumerate(observers)]
    place = scribe.rr.Points3D(
        observers[:, :3], radii=LARGE * scribe.scale, colors=color, labels=names, show_labels=True
    )
    ranges = scribe.rr.LineStrips3D(rings, radii=1.2 * scribe.scale, colors=(*color[:3], 140))
    scribe.stream.log(scribe.root + OBSERVERS, place, static=True)
    scribe.stream.log(f"{scribe.root}{OBSERVERS}/ranges", ranges, static=True)
