"""Recorded tracks: read them from files, resample them, cut them into windows, and find the leaders in them."""

from __future__ import annotations

from usnet_env.tracks.findings import Finding, TrackReport
from usnet_env.tracks.leaders import DetectedWindow, FoundLeaders, Leader, find_leaders
from usnet_env.tracks.links import Link
from usnet_env.tracks.reading import read_tracks
from usnet_env.tracks.tracks import Clock, Tracks
from usnet_env.tracks.windows import TrackWindow

__all__ = [
    "Clock",
    "DetectedWindow",
    "Finding",
    "FoundLeaders",
    "Leader",
    "Link",
    "TrackReport",
    "TrackWindow",
    "Tracks",
    "find_leaders",
    "read_tracks",
]
