"""Rerun recordings: one of an episode, and one of two detectors on the same swarm.

Rerun is an extra (``pip install 'usnet[replay]'``) and is imported only when a recording is written. Each recording has
a stream of its own; Rerun's global state does not change.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING
from uuid import uuid4

import numpy as np

from usnet_env.config import ArgumentError, how_to_install
from usnet_env.drawing import MissingExtraError
from usnet_env.files import as_path, atomic_write
from usnet_env.replay.course import ABOUT, CURVES, write_course
from usnet_env.replay.episode import EpisodeRecord, check_record
from usnet_env.replay.layout import arrange_comparison, arrange_views
from usnet_env.replay.mind import write_mind
from usnet_env.replay.scribe import Scribe
from usnet_env.replay.story import explain_comparison
from usnet_env.replay.world import write_world

if TYPE_CHECKING:
    import rerun as rr
    import rerun.blueprint as rrb


def _make_stream() -> rr.RecordingStream:
    """The stream of a recording, without a file yet."""
    try:
        import rerun as rr
    except ImportError:
        raise MissingExtraError(f"Replays need rerun-sdk; {how_to_install('replay')}.") from None
    # Recordings with the same application id share one camera and one layout in the viewer.
    recording_id = str(uuid4())
    stream = rr.RecordingStream(f"usnet {recording_id}", recording_id=recording_id)
    stream.set_log_time_enabled(False)
    stream.set_log_tick_enabled(False)
    return stream


def _write(
    scribes: Sequence[Scribe], layout: rrb.Blueprint, name: str, path: str | os.PathLike[str], about: str = ""
) -> Path:
    """Write the episodes of some scribes, which share a stream, and the text ``about`` them; the file appears whole."""
    place = as_path("path", path)
    rr, stream = scribes[0].rr, scribes[0].stream
    with atomic_write(place) as aside:
        stream.save(aside, default_blueprint=layout)
        try:
            stream.send_recording_name(name)
            for scribe in scribes:
                for write in (write_world, write_mind, write_course):
                    write(scribe)
            if about:
                stream.log(ABOUT, rr.TextDocument(about, media_type=rr.MediaType.MARKDOWN), static=True)
        finally:
            stream.disconnect()  # writes the rest and closes the file
    return place


def write_recording(record: EpisodeRecord, path: str | os.PathLike[str]) -> Path:
    """Write an episode as a Rerun recording that contains its layout; the file appears whole.

    The left view shows what the detector sees, and its answer when it is given: found groups, found leaders,
    probabilities, attention. The right view shows the truth and the verdict. The timelines are ``time``, seconds of the
    replay with a pause after each answer, destruction and re-merge; ``step``, see
    :func:`usnet_env.replay.scribe.list_steps`; and ``round``. ``rerun PATH`` opens the file.

    Args:
        record: the episode.
        path: the file to write, with the suffix ``.rrd`` by convention; an existing file is replaced.

    Returns:
        The path.

    Raises:
        ArgumentError: the place can't be written to.
        MissingExtraError: rerun-sdk is not installed.
    """
    scribe = Scribe(check_record(record), _make_stream())
    return _write([scribe], arrange_views(scribe), f"{record.env_id} seed {record.seed}: {record.detector}", path)


def write_comparison(first: EpisodeRecord, second: EpisodeRecord, path: str | os.PathLike[str]) -> Path:
    """Write two episodes that began with the same swarm as one recording, side by side.

    Args:
        first: the episode of one detector.
        second: that of another one.
        path: the file to write; an existing file is replaced.

    Returns:
        The path.

    Raises:
        ArgumentError: the first windows of the episodes differ, or the place can't be written to.
        MissingExtraError: rerun-sdk is not installed.
    """
    records = [check_record(first), check_record(second)]
    same = np.array_equal(first.position[0], second.position[0]) and first.labelled == second.labelled
    if not same or (first.labelled and not np.array_equal(first.head, second.head)):  # else they are those found
        raise ArgumentError("second must begin with the same swarm as first, got an episode with another first window.")
    names = [record.detector or f"detector {letter}" for record, letter in zip(records, "AB", strict=True)]
    labels = [f"{letter} {name}" if names[0] == names[1] else name for letter, name in zip("AB", names, strict=True)]
    stream = _make_stream()
    scribes = [
        Scribe(first, stream, "a/", color=CURVES["precision"][1]),
        Scribe(second, stream, "b/", color=CURVES["recall"][1]),
    ]
    for scribe in scribes:  # one scale, so that both views show the swarm from the same place
        scribe.span = max(each.span for each in scribes)
        scribe.scale = max(each.scale for each in scribes)
    layout, about = arrange_comparison(scribes, labels), explain_comparison(records, labels)
    return _write(scribes, layout, f"{' and '.join(labels)}, seed {first.seed}", path, about)
