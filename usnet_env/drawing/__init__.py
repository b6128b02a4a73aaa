"""Drawing of a swarm and a round, used by the environments' ``render`` and by the figures of the replay.

Matplotlib is an optional dependency (``pip install 'usnet[render]'``), imported when a figure is drawn. Its global
state (pyplot, ``rcParams``) is not changed.
"""

from __future__ import annotations

from usnet_env.drawing.frames import EpisodeFrames, describe_frame, round_frame
from usnet_env.drawing.maps import (
    CLUSTER_COLORS,
    FOLLOWER_MARK,
    HEAD_MARK,
    HIT,
    HIT_MARK,
    LINK_MARK,
    MISSED,
    NO_CLUSTER_COLOR,
    REDUNDANT,
    TRACK_WORDS,
    UNLED_MARK,
    Limits,
    MissingExtraError,
    cluster_colors,
    dashed_ring,
    draw_legend,
    draw_round,
    last_seen_position,
    limits_around,
    new_figure,
    round_marks,
)
from usnet_env.drawing.names import abbreviate, annotate_points, text_size
from usnet_env.drawing.style import COLORS, FORMATS, MARKERS, caption_figure, escape_math, style_axes, write_figure

__all__ = [
    "CLUSTER_COLORS",
    "COLORS",
    "FOLLOWER_MARK",
    "FORMATS",
    "HEAD_MARK",
    "HIT",
    "HIT_MARK",
    "LINK_MARK",
    "MARKERS",
    "MISSED",
    "NO_CLUSTER_COLOR",
    "REDUNDANT",
    "TRACK_WORDS",
    "UNLED_MARK",
    "EpisodeFrames",
    "Limits",
    "MissingExtraError",
    "abbreviate",
    "annotate_points",
    "caption_figure",
    "cluster_colors",
    "dashed_ring",
    "describe_frame",
    "draw_legend",
    "draw_round",
    "escape_math",
    "last_seen_position",
    "limits_around",
    "new_figure",
    "round_frame",
    "round_marks",
    "style_axes",
    "text_size",
    "write_figure",
]
