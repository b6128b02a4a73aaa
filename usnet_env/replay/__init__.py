"""Episodes kept in a neutral file, and the pictures and replays that are made from it, again whenever one likes."""

from __future__ import annotations

from usnet_env.replay.episode import EpisodeRecord
from usnet_env.replay.figure import draw_episode, episode_figure
from usnet_env.replay.play import Round, play
from usnet_env.replay.recording import write_recording

__all__ = ["EpisodeRecord", "Round", "draw_episode", "episode_figure", "play", "write_recording"]
