"""Read GPX files without building a tree; a document type, which could define entities, is refused."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.parsers import expat

import numpy as np

from usnet_env.config import ArgumentError, quote
from usnet_env.tracks.columns import keep_fixed
from usnet_env.tracks.formats import Block, ReadOptions
from usnet_env.tracks.opening import damaged_file, open_expanded

__all__ = ["read_gpx"]

_LONGEST_TEXT = 10_000  # characters of a name, height or time


class _Points:
    """Collects the track points of a GPX file, with the name of their track."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.values: dict[str, list[Any]] = {"id": [], "lon": [], "lat": [], "z": [], "t": []}
        self._open: list[str] = []
        self._text: list[str] = []
        self._tracks, self._name = 0, ""
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
            self._tracks += 1
            self._name = ""
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
            self._name = text
        elif inside == "trkpt" and kind in ("ele", "time"):
            self._point["z" if kind == "ele" else "t"] = text
        elif kind == "trkpt":
            for role, value in self._point.items():
                self.values[role].append(value)
            self.values["id"].append(self._name or f"{self.path.stem}-{self._tracks}")


def read_gpx(path: Path, options: ReadOptions) -> Iterator[Block]:
    """Read the track points of a GPX file; the ids are the tracks' names, or the file's name with a number.

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
    if not points.values["id"]:
        raise ArgumentError(f"path must be a GPX file with track points, got {quote(os.fspath(path))} without any.")
    names = {"id": "name", "lon": "lon", "lat": "lat", "z": "ele", "t": "time"}
    found = keep_fixed(names, options.columns, quote(os.fspath(path)))
    values = {role: points.values[role] for role in found}
    yield Block(values, found, np.arange(1, len(values["id"]) + 1), "point", own_ids=True)
