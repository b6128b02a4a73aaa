"""Episodes in a neutral file, and the pictures and replays that are made from it at any later time."""

from __future__ import annotations

from usnet_env.replay.animate import animate
from usnet_env.replay.episode import EpisodeRecord
from usnet_env.replay.figure import draw_episode, write_picture
from usnet_env.replay.record import record_episode
from usnet_env.replay.rerun import write_recording

__all__ = ["EpisodeRecord", "record_episode"]
__all__ += ["animate", "draw_episode", "write_picture", "write_recording"]
