"""The layout of a recording: which views it opens with, and where the camera is."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from usnet_env.replay.course import ABOUT, GAME, LANES, ROUND
from usnet_env.replay.mind import (
    ATTENTION,
    CHART_HEIGHT,
    CHART_WIDTH,
    FEATURES,
    FOUND,
    SCORES,
    attention_maps,
    place_maps,
)
from usnet_env.replay.scribe import Scribe, parse_color
from usnet_env.replay.story import name_round
from usnet_env.replay.world import OBSERVERS, SMALL, SWARM, VERDICT, WORLD

if TYPE_CHECKING:
    import rerun.blueprint as rrb

_BACKGROUND, _UNKNOWN = "#101418", "#8C949C"
_MOST_LINKS, _MOST_ATTENTION = 60, 30  # UAVs; in a larger swarm, these lines are hidden until they are asked for


def _space(scribe: Scribe, name: str, detector: bool) -> rrb.Spatial3DView:
    """A view of the swarm: as the detector sees it, with its answer; or the truth, with the verdict."""
    import rerun.blueprint as rrb

    rr = scribe.rr
    eye = rrb.EyeControls3D(
        kind=rrb.Eye3DKind.Orbital,
        position=scribe.span * np.array([0.0, -0.8, 0.9]),
        look_target=scribe.span * np.array([0.0, -0.08, 0.0]),
        eye_up=[0.0, 0.0, 1.0],
    )
    root = f"/{scribe.root}"
    hidden = rrb.EntityBehavior(visible=False)
    overrides: dict[Any, Any] = {}
    parts = [f"{WORLD}/ground", OBSERVERS]
    if detector:
        grey = np.array([parse_color(_UNKNOWN)], np.uint8)
        alike: dict[str, Any] = {"colors": grey, "radii": [0.8 * SMALL * scribe.scale]}
        parts += [f"{SWARM}/{kind}" for kind in ("heads", "followers", "tracks", "destroyed")] + [FOUND]
        overrides |= {f"{root}{SWARM}/{kind}": rr.Points3D.from_fields(**alike) for kind in ("heads", "followers")}
        faint = np.array([parse_color(_UNKNOWN, 110)], np.uint8)
        overrides[f"{root}{SWARM}/tracks"] = rr.LineStrips3D.from_fields(colors=faint)
        if scribe.record.uavs > _MOST_ATTENTION:
            overrides[f"{root}{FOUND}/attention"] = hidden
    else:
        parts += [SWARM, VERDICT]
        if scribe.record.uavs > _MOST_LINKS:
            overrides[f"{root}{SWARM}/links"] = hidden
    return rrb.Spatial3DView(
        origin=root.rstrip("/") or "/",  # not the world itself, whose transform would have no effect
        contents=[f"{root}{part}/**" for part in parts],
        name=name,
        eye_controls=eye,
        background=parse_color(_BACKGROUND)[:3],
        line_grid=False,
        overrides=overrides,
    )


def _flat(origin: str, name: str, x: Sequence[float], y: Sequence[float]) -> Any:
    import rerun.blueprint as rrb

    bounds = rrb.VisualBounds2D(x_range=list(x), y_range=list(y))
    return rrb.Spatial2DView(origin=origin, name=name, background=parse_color(_BACKGROUND)[:3], visual_bounds=bounds)


def _panels(scribe: Scribe) -> list[Any]:
    """The views of scores, attention and features that the record has data for."""
    record, root = scribe.record, f"/{scribe.root}"
    lowest = 0.62 + CHART_HEIGHT * bool((record.scores < 0).any())
    scores = _flat(f"{root}{SCORES}", "Scores, highest first", (-0.1, CHART_WIDTH + 0.1), (-1.35, lowest))
    panels = [scores]
    if record.attention is not None:
        maps = attention_maps(record, 0)
        _, (high, wide) = place_maps(len(maps), side := len(maps[0][1]))
        bounds = (-0.05 * side, wide + 0.05 * side), (-0.3 * side, high + 0.05 * side)  # titles stand above the maps
        panels.append(_flat(f"{root}{ATTENTION}", "Attention of a UAV (row): bright = most", *bounds))
    if record.features is not None:
        panels.append(_flat(f"{root}{FEATURES}", "Feature space, colour = found group", (-0.6, 0.6), (-0.6, 0.6)))
    return panels


def _curve(scribe: Scribe, contents: Sequence[str], name: str, **more: Any) -> Any:
    """A curve over the whole game."""
    import rerun.blueprint as rrb

    span = scribe.rr.TimeRange(
        start=scribe.rr.TimeRangeBoundary.absolute(seconds=0.0),
        end=scribe.rr.TimeRangeBoundary.absolute(seconds=float(scribe.clock.seconds.max())),
    )
    return rrb.TimeSeriesView(
        origin="/", contents=list(contents), name=name, axis_x=rrb.TimeAxis(view_range=span),
        plot_legend=rrb.PlotLegend(visible=False), **more,
    )  # fmt: skip


def _frame(*rows: Any, shares: Sequence[float]) -> rrb.Blueprint:
    import rerun.blueprint as rrb

    panel = rrb.TimePanel(state="collapsed", timeline="time", play_state="paused", loop_mode="off")
    return rrb.Blueprint(rrb.Vertical(*rows, row_shares=list(shares)), panel, collapse_panels=True)


def arrange_views(scribe: Scribe) -> rrb.Blueprint:
    """The layout of a recording of one episode."""
    import rerun.blueprint as rrb

    record, root = scribe.record, f"/{scribe.root}"
    about = rrb.TextDocumentView(origin=f"{root}{ABOUT}", name="What you see")
    told = rrb.TextDocumentView(origin=f"{root}{ROUND}", name=f"This {name_round(record).lower()}")
    texts = rrb.Vertical(about, told, row_shares=[3, 2])
    leaders = _curve(scribe, [f"{root}{GAME}/leaders"], "Leaders named")
    if not record.labelled:
        views = rrb.Horizontal(_space(scribe, "The tracks", detector=False), texts, column_shares=[5, 2])
        return _frame(views, rrb.Horizontal(*_panels(scribe), leaders), shares=[3, 1])
    seen = _space(scribe, "What the detector sees and answers", detector=True)
    truth = _space(scribe, "The truth", detector=False)
    if record.recorded:
        views = rrb.Horizontal(seen, truth, texts, column_shares=[4, 4, 3])
        return _frame(views, rrb.Horizontal(*_panels(scribe), leaders), shares=[3, 1])
    unit = rrb.ScalarAxis(range=(-0.05, 1.05))
    count = rrb.ScalarAxis(range=(-0.3, float(record.head.sum()) + 0.3))
    shares = [f"{root}{GAME}/{name}" for name in ("precision", "recall")]
    curves = [
        _curve(scribe, [f"{root}{GAME}/heads_left"], "Heads left", axis_y=count),
        _curve(scribe, shares, "Precision (blue), recall (yellow)", axis_y=unit),
        _curve(scribe, [f"{root}{GAME}/J"], "J so far"),
    ]
    lanes = rrb.StateTimelineView(origin=f"{root}{LANES}", name="The game and its heads")
    return _frame(
        rrb.Horizontal(seen, truth, texts, column_shares=[4, 4, 3]),
        rrb.Horizontal(*_panels(scribe), rrb.Vertical(*curves), lanes),
        shares=[3, 1.6],
    )


def arrange_comparison(scribes: Sequence[Scribe], labels: Sequence[str]) -> rrb.Blueprint:
    """The layout of a recording of two episodes on the same swarm, side by side."""
    import rerun.blueprint as rrb

    columns, labelled = [], all(scribe.record.labelled for scribe in scribes)
    for scribe, label in zip(scribes, labels, strict=True):
        part = name_round(scribe.record).lower()
        told = rrb.TextDocumentView(origin=f"/{scribe.root}{ROUND}", name=f"{label}: this {part}")
        views = [_space(scribe, f"{label}: verdict" if labelled else label, False)]
        if labelled:
            views.insert(0, _space(scribe, f"{label}: answer", True))
        columns.append(rrb.Vertical(*views, told, row_shares=[3] * len(views) + [2]))
    longest = max(scribes, key=lambda scribe: scribe.record.rounds)
    shown = {"leaders": "Leaders named"} if longest.record.recorded else {"heads_left": "Heads left", "J": "J so far"}
    curves = [
        _curve(
            longest,
            [f"/{scribe.root}{GAME}/{name}" for scribe in scribes],
            f"{title}: {labels[0]} blue, {labels[1]} yellow",
        )
        for name, title in shown.items()
    ]
    about = rrb.TextDocumentView(origin=f"/{ABOUT}", name="What you see")
    side = rrb.Vertical(about, *curves, row_shares=[2, *[1] * len(curves)])
    return _frame(rrb.Horizontal(*columns, side, column_shares=[4, 4, 2]), shares=[1])
