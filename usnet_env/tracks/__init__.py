"""Recorded tracks: read them from files, resample them, cut them into windows, and find the leaders in them."""

from __future__ import annotations

from usnet_env.tracks.changes import Period
from usnet_env.tracks.found import DetectedWindow, Event, Leader, Link
from usnet_env.tracks.leaders import find_leaders
from usnet_env.tracks.live import LeaderTracker, LiveLeaders
from usnet_env.tracks.read import read_tracks
from usnet_env.tracks.report import TrackReport
from usnet_env.tracks.result import FoundLeaders
from usnet_env.tracks.samples import Clock
from usnet_env.tracks.tracks import Tracks, TrackWindow

__all__ = ["Clock", "TrackReport", "TrackWindow", "Tracks", "read_tracks"]
__all__ += ["DetectedWindow", "Event", "FoundLeaders", "Leader", "Link", "Period", "find_leaders"]
__all__ += ["LeaderTracker", "LiveLeaders"]
