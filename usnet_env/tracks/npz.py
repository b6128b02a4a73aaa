"""Read NPZ files: an array for each column, or the positions of all ids at all instants in one array."""

from __future__ import annotations

import os
import zipfile
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from usnet_env.config import ArgumentError, quote
from usnet_env.tracks.columns import check_names, choose_columns, is_movebank, keep_fixed
from usnet_env.tracks.formats import Block, ReadOptions
from usnet_env.tracks.labels import Labels, to_labels, to_text
from usnet_env.tracks.opening import check_expanded_size, damaged_file

_Arrays = Mapping[str, NDArray[Any]]
#: The arrays beside ``position`` by role, with the names that are guessed.
_BESIDE = {"id": ("id", "ids"), "t": ("t", "time"), "frame": (), "leader": ("leader",), "seen": ("seen",)}


def read_npz(path: Path, options: ReadOptions) -> Iterator[Block]:
    """Read an NPZ file: 1-D arrays of one length by role, or ``position`` ``(T, N, 2 or 3)``.

    With ``position`` there may be ``t`` ``(T,)`` (otherwise the numbers of the instants count), ``id`` ``(N,)``
    (otherwise they are numbered), ``leader`` ``(N,)`` or ``(T, N)`` and ``seen`` ``(T, N)``; NaN is unseen as well.

    Raises:
        ArgumentError: the file is damaged, needs too much memory, lacks an array, or shapes differ.
    """
    where = quote(os.fspath(path))
    arrays = _load(path, options)
    if "position" in arrays and arrays["position"].ndim == 3:
        yield _unfold(arrays, options.columns, where)
        return
    found, marks = choose_columns(list(arrays), options.columns, where)
    read = found | marks
    lengths = {name: arrays[name].shape for name in read.values()}
    if any(len(shape) != 1 or shape != lengths[found["id"]] for shape in lengths.values()):
        raise ArgumentError(f"path must hold 1-D arrays of one length, got {where} with the shapes {quote(lengths)}.")
    rows = np.arange(2, 2 + len(arrays[found["id"]]))
    values = {role: _plain(arrays[name]) for role, name in read.items()}
    yield Block(values, found, rows, movebank=is_movebank(list(arrays)))


def _load(path: Path, options: ReadOptions) -> dict[str, NDArray[Any]]:
    try:
        with zipfile.ZipFile(path) as archive:
            check_expanded_size(path, sum(each.file_size for each in archive.infolist()), options.max_bytes)
        with np.load(path, allow_pickle=False) as file:
            return {name: file[name] for name in file.files}
    except ArgumentError:
        raise
    except Exception as error:  # a damaged header makes NumPy raise whatever Python's own tokenizer raises
        raise damaged_file(path, error, "NPZ") from None


def _plain(array: NDArray[Any]) -> Any:
    return array if array.dtype.kind in "fiuM" else [to_text(each) for each in array.tolist()]


def _unfold(arrays: _Arrays, columns: Mapping[str, str], where: str) -> Block:
    """The rows of ``position`` ``(T, N, 2 or 3)``, id by id."""
    position = arrays["position"]
    instants, uavs, axes = position.shape
    if axes not in (2, 3) or position.dtype.kind not in "fiu":
        raise ArgumentError(
            f"position must have shape (any, any, 2 or 3) and hold numbers in {where}, got {quote(position)}."
        )
    names = keep_fixed(
        dict.fromkeys("xyz"[:axes], "position"),
        {role: name for role, name in columns.items() if role not in _BESIDE},
        where,
    )
    beside = _find_beside(arrays, columns, where)
    found = {role: arrays[name] for role, name in beside.items()}
    _check_beside(found, instants, uavs, where)
    seen = np.isfinite(position).all(axis=2) & found.pop("seen", np.ones((), bool)).astype(bool)
    who, when = np.nonzero(seen.T)
    ids = to_labels(_plain(found.pop("id", np.arange(uavs))))
    twice = next((name for name, count in Counter(ids).items() if count > 1), None)
    if twice is not None:
        raise ArgumentError(f"id must name each of the {uavs} tracks once in {where}, got {quote(twice)} twice.")
    values: dict[str, Any] = {"id": ids[who]}
    leader = found.pop("leader", None)
    for role, time in (found or {"frame": np.arange(instants)}).items():
        plain = _plain(time)
        values[role] = plain[when] if isinstance(plain, np.ndarray) else Labels(when, plain)
    values |= {role: position[when, who, "xyz".index(role)] for role in names}
    if leader is not None:
        values["leader"] = to_labels(_plain(leader.reshape(-1)))[who if leader.ndim == 1 else when * uavs + who]
    return Block(values, {role: (names | beside).get(role, "index") for role in values}, when, "instant")


def _find_beside(arrays: _Arrays, columns: Mapping[str, str], where: str) -> dict[str, str]:
    """The arrays beside ``position`` by role: those that the caller has named, and those with a usual name."""
    mapping = {role: name for role, name in columns.items() if role in _BESIDE}
    found = check_names(list(arrays), mapping, where)
    for role, names in _BESIDE.items():
        guess = next((name for name in names if name in arrays and name not in found.values()), None)
        if role not in mapping and guess is not None and not (role == "t" and "frame" in found):
            found[role] = guess
    return found


def _check_beside(arrays: _Arrays, instants: int, uavs: int, where: str) -> None:
    shapes: dict[str, list[tuple[int, ...]]] = {
        "id": [(uavs,)],
        "leader": [(uavs,), (instants, uavs)],
        "seen": [(instants, uavs)],
    }
    for role, array in arrays.items():
        takes = shapes.get(role, [(instants,)])
        if array.shape not in takes:
            raise ArgumentError(f"{role} must have shape {' or '.join(map(str, takes))} in {where}, got {array.shape}.")
    if "seen" in arrays and arrays["seen"].dtype.kind not in "biuf":
        raise ArgumentError(f"seen must hold truth values in {where}, got {quote(arrays['seen'])}.")
