"""Ids and leaders of rows: texts or whole numbers, each different one held once, and counted over all files."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from usnet_env.arrays import Indices, Mask
from usnet_env.tracks.values import is_none

_MOST_NAMED = 3  # leaders without a track
_DECIMAL = re.compile(r"[+-]?[0-9]+(\.[0-9]*)?")


@dataclass(frozen=True)
class Labels:
    """Values of rows, each different one held once, as in a dictionary column.

    Args:
        index: ``(rows,)`` int64, which of ``names`` each row has.
        names: the values.
    """

    index: Indices
    names: Sequence[Any]

    def __len__(self) -> int:
        return len(self.index)

    def __iter__(self) -> Iterator[Any]:
        """The value of each row; equal ones are one object."""
        return (self.names[k] for k in self.index.tolist())

    def __getitem__(self, rows: Indices) -> Labels:
        return Labels(self.index[rows], self.names)


def to_text(value: Any) -> Any:
    """Decode bytes, in which some formats hold texts; other values stay as they are."""
    return value.decode("utf-8", "backslashreplace") if isinstance(value, bytes) else value


def to_labels(values: Labels | Sequence[Any] | NDArray[Any]) -> Labels:
    """Labels of rows as texts without spaces around them, or as whole numbers; ``""`` is none.

    Args:
        values: the labels as they are in the file, ``(rows,)``.
    """
    if isinstance(values, np.ndarray):
        different, index = np.unique(values, return_inverse=True)
        values = Labels(index.astype(np.int64), different.tolist())
    elif not isinstance(values, Labels):
        code: dict[Any, int] = {}
        index = np.fromiter((code.setdefault(each, len(code)) for each in values), np.int64, len(values))
        values = Labels(index, list(code))
    return Labels(values.index, [_clean(each) for each in values.names])


def _clean(label: Any) -> str | int:
    label = to_text(label)
    if isinstance(label, str):
        return label.strip()
    if label is None or (isinstance(label, float) and math.isnan(label)):
        return ""
    if isinstance(label, float) and label.is_integer():
        return int(label)
    return label if isinstance(label, int) and not isinstance(label, bool) else str(label)


class LabelBook:
    """Numbers the different labels of all files in the order in which they come.

    A label is one in all files, also if it is a whole number in one of them and a text in another. Labels that are
    known in their own file only, such as the names of tracks in GPX files, are different in different files.
    """

    def __init__(self) -> None:
        self._code: dict[tuple[str, Path | None], int] = {}  # by text and file, without links and ".."
        self._given: dict[Path, Path] = {}  # the path of each of these files as the caller has named it
        self._whole = True

    def add(self, labels: Labels, good: Mask, path: Path | None = None) -> NDArray[np.int32]:
        """The numbers of the labels of those rows that are ``good``, ``(good rows,)``.

        Args:
            labels: the labels of all rows.
            good: ``(rows,)`` which rows to read.
            path: the file, if the labels are known in it only.
        """
        file = path and path.resolve()
        if path and file:
            self._given.setdefault(file, path)
        index = labels.index[good]
        used, first = np.unique(index, return_index=True)
        codes = np.full(len(labels.names), -1, np.int32)
        for k in used[np.argsort(first)].tolist():  # in the order of the rows
            label = labels.names[k]
            self._whole = self._whole and isinstance(label, int)
            codes[k] = self._code.setdefault((str(label), file), len(self._code))
        return codes[index]

    def names(self) -> tuple[str | int, ...]:
        """The labels in the order of their numbers: whole numbers if all are, otherwise texts.

        A label of several files that is another one in each has the name of its file added, as often as it takes until
        no other label has this name.
        """
        places: dict[str, list[Path | None]] = {}
        for text, file in self._code:
            places.setdefault(text, []).append(file)
        taken, texts = set(places), []
        for text, file in self._code:
            name = text
            if file is not None and len(places[text]) > 1:
                others = [self._given[each] for each in places[text] if each not in (None, file)]
                added = f" ({_tell_apart(self._given[file], others)})"
                while name in taken:
                    name += added
                taken.add(name)
            texts.append(name)
        return tuple(map(int, texts)) if self._whole else tuple(texts)


def _tell_apart(path: Path, others: Sequence[Path]) -> str:
    """The end of a path that no other one has: the file's name, or with its folders."""
    parts = [each.parts for each in others]
    depth = 1
    while any(path.parts[-depth:] == each[-depth:] for each in parts):
        depth += 1
    return Path(*path.parts[-depth:]).as_posix()


def find_labels(labels: Iterable[str | int], known: Sequence[str | int]) -> Indices:
    """``(labels,)`` index of each label among those that are known, -1 for none.

    A label is the same text, or else an equal number: ``0.0``, which pandas writes for whole numbers in a column with
    gaps, is the label 0. A number that equals several known labels, such as 1 and 01, is none of them.
    """
    same = {str(each): k for k, each in enumerate(known)}
    equal: dict[Decimal, int] = {}
    for text, k in same.items():
        if (number := _to_number(text)) is not None:
            equal[number] = -1 if number in equal else k
    found = []
    for text in map(str, labels):
        number = None if text in same else _to_number(text)
        found.append(same.get(text, -1) if number is None else equal.get(number, -1))
    return np.array(found, np.int64)


def match_leaders(
    index: NDArray[np.integer[Any]],
    labels: Sequence[str | int],
    codes: NDArray[np.integer[Any]],
    ids: Sequence[str | int],
    where: str = "",
) -> tuple[Indices | None, list[str]]:
    """Which id each sample follows.

    Args:
        index: ``(S,)`` which of the labels names the leader of each sample.
        labels: the different labels of leaders.
        codes: ``(S,)`` index of the id of each sample.
        ids: the N ids.
        where: names the column in a sentence, such as ``" in column leader"``.

    Returns:
        ``(S,)`` index of each sample's leader, -1 for none; ``None`` if none of those that are named has a track. And a
        sentence about each kind of leader that was not found.
    """
    known, notes = find_labels(labels, ids), []
    unknown = [label for label, k in zip(labels, known, strict=True) if k < 0 and not is_none(label)]
    if unknown:
        names = ", ".join(map(str, unknown[:_MOST_NAMED]))
        notes.append(f"Leaders without a track: {len(unknown)} ({names}).")
        if (known < 0).all():
            return None, [*notes, f"No leader{where} has a track: it is not known who leads."]
    leader = known[index]
    return np.where(leader == codes, -1, leader), notes


def _to_number(text: str) -> Decimal | None:
    return Decimal(text) if _DECIMAL.fullmatch(text) else None
