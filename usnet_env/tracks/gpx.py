"""Read GPX files without building a tree; a document type, which could define entities, is refused."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.parsers import expat

import numpy as np

from usnet_env.config import ArgumentError, quote
from usnet_env.tracks.columns import keep_fixed
from usnet_env.tracks.formats import Block, ReadOptions
from usnet_env.tracks.labels import Labels
from usnet_env.tracks.opening import damaged_file, open_expanded

_LONGEST_TEXT = 10_000  # characters of a name, height or time


class _Points:
    """Collects the track points of a GPX file, with the number of their track, and the names of the tracks."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.values: dict[str, list[Any]] = {"lon": [], "lat": [], "z": [], "t": []}
        self.tracks: list[int] = []  # of each point, from 1
        self._open: list[str] = []
        self._text: list[str] = []
        self._names = [""]  # by number of the track; a point outside of tracks has number 0
        self._point: dict[str, Any] = {}

    def refuse_entities(self, *_: Any) -> None:
        raise ArgumentError(
            f"path must be a GPX file without a document type, got {quote(os.fspath(self.path))}, which declares one."
        )

    def start(self, tag: str, attributes: dict[str, str]) -> None:
        kind = tag.rpartition(":")[2]
        self._open.append(kind)
        self._text = []
        if kind == "trk":
            self._names.append("")
        elif kind == "trkpt":
            self._point = {"lon": attributes.get("lon", ""), "lat": attributes.get("lat", ""), "z": "", "t": ""}

    def text(self, part: str) -> None:
        if sum(map(len, self._text)) < _LONGEST_TEXT:
            self._text.append(part)

    def end(self, tag: str) -> None:
        kind, inside = self._open.pop(), self._open[-1] if self._open else ""
        text = "".join(self._text).strip()
        self._text = []
        if inside == "trk" and kind == "name":
            self._names[-1] = text
        elif inside == "trkpt" and kind in ("ele", "time"):
            self._point["z" if kind == "ele" else "t"] = text
        elif kind == "trkpt":
            for role, value in self._point.items():
                self.values[role].append(value)
            self.tracks.append(len(self._names) - 1)

    def ids(self) -> Labels:
        """The id of each point: the name of its track, with the track's number where tracks share a name.

        A track without a name has that of the file, with its number. The number is added as often as it takes until no
        other track has this name.
        """
        used, index = np.unique(np.array(self.tracks, np.int64), return_inverse=True)
        names = [self._names[k] or f"{self.path.stem}-{k}" for k in used.tolist()]
        count, ids = Counter(names), []
        taken = set(names)
        for k, name in zip(used.tolist(), names, strict=True):
            text = name
            while count[name] > 1 and text in taken:
                text += f"-{k}"
            taken.add(text)
            ids.append(text)
        return Labels(index.astype(np.int64), ids)


def read_gpx(path: Path, options: ReadOptions) -> Iterator[Block]:
    """Read the track points of a GPX file; the ids are the tracks' names, or the file's name with a number.

    Where several tracks have one name, each has its number in the file added.

    Raises:
        ArgumentError: the file is damaged or in another encoding, declares a document type, or holds no track points.
    """
    points = _Points(path)
    parser = expat.ParserCreate()
    parser.buffer_text = True
    parser.StartDoctypeDeclHandler = points.refuse_entities
    parser.StartElementHandler, parser.EndElementHandler = points.start, points.end
    parser.CharacterDataHandler = points.text
    try:
        with open_expanded(path, options.max_bytes) as file:
            parser.ParseFile(file)
    except ArgumentError:
        raise
    except (expat.ExpatError, LookupError, ValueError) as error:  # the last two: of the encoding that it declares
        raise damaged_file(path, error, "GPX") from None
    if not points.tracks:
        raise ArgumentError(f"path must be a GPX file with track points, got {quote(os.fspath(path))} without any.")
    names = {"id": "name", "lon": "lon", "lat": "lat", "z": "ele", "t": "time"}
    found = keep_fixed(names, options.columns, quote(os.fspath(path)))
    values = {role: points.ids() if role == "id" else points.values[role] for role in found}
    yield Block(values, found, np.arange(1, len(points.tracks) + 1), "point", own_ids=True)
