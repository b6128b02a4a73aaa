"""Keep rows in a file that grows at its end, and an evaluation in a folder that can be resumed."""

from __future__ import annotations

import io
import json
import os
import time
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from contextlib import ExitStack, suppress
from importlib.metadata import version
from mmap import ACCESS_READ, mmap
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from usnet_env.config import ArgumentError, quote
from usnet_env.evaluation.identity import describe_difference, differing_keys
from usnet_env.evaluation.metrics import CLUSTER_METRICS, METRICS
from usnet_env.evaluation.table import Columns, RowTable, read_table
from usnet_env.files import FileLock, atomic_write
from usnet_env.provenance import machine, versions

RUN, EPISODES, SUMMARY = "run.json", "episodes.csv", "summary.json"

_INTEGERS = ("episode", "swarm_seed", "detector_seed", "uavs", "heads", "rounds", "success", "exact")
#: The columns of ``episodes.csv`` that are no metrics.
KEYS = ("detector", "episode", "swarm_seed", "detector_seed", "uavs", "heads")
#: The columns of ``episodes.csv`` with their types.
COLUMNS: Columns = {
    name: "int" if name in _INTEGERS else "float | None" if name in CLUSTER_METRICS else "float"
    for name in (*KEYS, *METRICS)
} | {"detector": "str"}

#: The arguments of a run that others may add to.
JOINING = ("detectors", "identities", "episodes")

_SYNC_EVERY = 10.0  # seconds; what is older survives a failure of power, and everything that of this program
_ROWS_AT_ONCE = 10_000


def write_text(path: Path, text: str) -> None:
    """Write a text file atomically: a reader sees the whole new text, or the file as it was before."""
    with atomic_write(path) as aside, aside.open("w", encoding="utf-8", newline="") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())


class RowFile:
    """A CSV file of rows that grows at its end: a row costs the same, however many there are.

    A program that is killed leaves at most a part of its last line, which is removed when the file is opened again. If
    the disk is full, the file ends with the last complete row. :meth:`sort` replaces the file as a whole.

    Args:
        path: the file; it is created with the first row.
        columns: names and types of the columns.
        lock: keeps other programs away; by default the file's own lock, which :meth:`close` releases.
        digits: decimals of ``float``; ``None``: as many as are needed to read the same value again.

    Attributes:
        table: all rows of the file.

    Raises:
        ArgumentError: another process has the lock, or the file holds something else.
    """

    def __init__(self, path: Path, columns: Columns, lock: FileLock | None = None, digits: int | None = None) -> None:
        self.path = path
        self._digits = digits
        self._file: io.FileIO | None = None
        self._end = 0
        self._stale = False  # whether the file holds rows that the table does not
        self._synced = time.monotonic()
        with ExitStack() as stack:
            if lock is None:
                lock = stack.enter_context(FileLock(path))
                lock.remove_unfinished(f"{path.stem}.")
            self._lock = lock
            self.table = read_table(path, columns)
            self._owned = stack.pop_all()

    def __enter__(self) -> RowFile:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def append(self, rows: Iterable[Mapping[str, Any]]) -> None:
        """Append rows to the file and the table.

        Raises:
            ArgumentError: the file or its folder was removed or changed, or cannot be written; the file then holds no
                part of these rows.
        """
        self._lock.check()
        self.drop_left_out()
        self._file = self._file or self._open()
        first = len(self.table)
        try:
            self.table.extend(rows)
            self._write(self._file, self.table.format_csv(first, digits=self._digits).encode())
        except BaseException:
            self.table = self.table[:first]
            raise

    def sort(self, order: Callable[[RowTable], Sequence[int] | NDArray[np.int64]]) -> None:
        """Sort the rows; the file is written again if that changes it.

        Args:
            order: returns the places of the rows in their new order.
        """
        places = np.asarray(order(self.table), np.int64)
        if (places == np.arange(len(places))).all():
            return
        self._lock.check()
        self.table = self.table.take(places)
        self._replace()

    def leave_out(self, places: NDArray[np.bool_]) -> None:
        """Leave out the rows at these ``places`` ``(R,)``; the file holds them until :meth:`drop_left_out`."""
        if places.any():
            self.table = self.table.take(np.flatnonzero(~places))
            self._stale = True

    def drop_left_out(self) -> None:
        """Write the file without the rows that were left out, if there are any."""
        if self._stale:
            self._replace()

    def close(self) -> None:
        """Close the file and release its lock."""
        if self._file is not None:
            with suppress(OSError):
                os.fsync(self._file.fileno())
            self._file.close()
            self._file = None
        self._owned.close()

    def _open(self) -> io.FileIO:
        """Open the file at the end of its last complete line; a new file appears with its header."""
        try:
            with self.path.open(encoding="utf-8", newline="") as lines:
                known = lines.readline() == ",".join(self.table.columns) + "\n"
        except FileNotFoundError:
            known = False
        if not known:
            self._replace()
        file = io.FileIO(self.path, "r+")
        with mmap(file.fileno(), 0, access=ACCESS_READ) as data:
            self._end = data.rfind(b"\n") + 1
        file.truncate(self._end)
        file.seek(self._end)
        return file

    def _replace(self) -> None:
        """Write the whole table in place of the file."""
        if self._file is not None:
            self._file.close()
            self._file = None
        with atomic_write(self.path) as aside, aside.open("w", encoding="utf-8", newline="") as file:
            file.write(",".join(self.table.columns) + "\n")
            for first in range(0, len(self.table), _ROWS_AT_ONCE):
                file.write(self.table.format_csv(first, first + _ROWS_AT_ONCE, self._digits))
            file.flush()
            os.fsync(file.fileno())
        self._stale = False

    def _write(self, file: io.FileIO, data: bytes) -> None:
        """Write at the end of the file, all of it or nothing."""
        found = os.fstat(file.fileno())
        try:
            same = os.path.samestat(os.stat(self.path), found) and found.st_size == self._end
        except OSError:
            same = False
        if not same:
            raise ArgumentError(
                f"out must stay as it is during a run, got {quote(str(self.path))}, which was removed or changed."
            )
        written = 0
        try:
            while written < len(data):
                written += file.write(data[written:]) or 0
        except OSError as error:
            raise ArgumentError(
                f"out must be a folder that can be written, got {quote(str(self.path.parent))}: {error.strerror}."
            ) from None
        finally:
            if written < len(data):
                file.truncate(self._end)
                file.seek(self._end)
            self._end = file.tell()
        if time.monotonic() - self._synced > _SYNC_EVERY:
            os.fsync(file.fileno())
            self._synced = time.monotonic()


class RunStore:
    """The folder of one run.

    More detectors, and more episodes, may join the run of a folder; every other argument must be the same. A detector
    that has failed may come back with other code or arguments: then its rows are played again.

    Args:
        folder: the folder; it is created if it does not exist.
        config: the arguments of the run as JSON values, with ``detectors`` (their labels), ``identities`` and
            ``episodes``.
        columns: of the rows.

    While it is open no other process can use the folder. Use it in a ``with`` statement.

    Attributes:
        config: the arguments, with the detectors and the episodes that the folder has.
        failures: why detectors have failed, by label; those that have not played all episodes since.

    Raises:
        ArgumentError: the folder holds a different run, files that are not a run, or a run that another process plays.
    """

    def __init__(self, folder: Path, config: Mapping[str, Any], columns: Columns = COLUMNS) -> None:
        self.folder = folder
        self.config: dict[str, Any] = json.loads(json.dumps(config))
        self._description: dict[str, Any] = {}  # what run.json holds
        self.failures: dict[str, str] = {}
        changed: list[str] = []
        if folder.exists() and not folder.is_dir():
            raise ArgumentError(f"out must be a folder, got the file {str(folder)!r}.")
        with ExitStack() as stack:
            self._lock = stack.enter_context(FileLock(folder / RUN))
            self._lock.remove_unfinished("")
            if (folder / RUN).exists():
                self._description = _read_description(folder)
                self.failures = dict(self._description.get("failures", {}))
                self.config, changed = _join(folder, self._description, self.config)
            elif (folder / EPISODES).exists():
                raise ArgumentError(
                    f"out must be a new folder or the folder of a run, got {str(folder)!r} with rows but no {RUN}."
                )
            self._rows = stack.enter_context(RowFile(folder / EPISODES, columns, self._lock))
            self._rows.leave_out(np.isin(self.table.column("detector"), changed))
            _check_once(self.table, folder)
            self._opened = stack.pop_all()

    def __enter__(self) -> RunStore:
        return self

    def __exit__(self, *_: object) -> None:
        self._opened.close()

    @property
    def table(self) -> RowTable:
        """The rows of all finished episodes."""
        return self._rows.table

    def append(self, rows: Iterable[Mapping[str, Any]]) -> None:
        """Append rows of finished episodes; the first call writes ``run.json`` as well.

        Raises:
            ArgumentError: the folder was removed during the run, or it cannot be written.
        """
        self._rows.drop_left_out()  # before their detector is described as another one
        if self._description.get("config") != self.config:  # only now: a run that is refused leaves nothing
            self._describe({"versions": versions(), "machine": machine(), **self._description, "config": self.config})
            (self.folder / SUMMARY).unlink(missing_ok=True)  # of the run before others joined it
        self._rows.append(rows)

    def add_secret(self, secret: str) -> None:
        """Write the secret of an isolated run that has ended to ``run.json``, after those of its earlier parts."""
        if self._description:
            secrets = dict.fromkeys([*self._description.get("secrets", []), secret])
            self._describe(self._description | {"secrets": list(secrets)})

    def note_failures(self, failures: Mapping[str, str], complete: Collection[str] = ()) -> None:
        """Write to ``run.json`` which detectors have failed, so that their rows are never taken for all of theirs.

        Args:
            failures: new ones, by label.
            complete: the labels that have played all episodes by now.
        """
        known = {label: why for label, why in self.failures.items() if label not in complete} | dict(failures)
        if known != self.failures:
            self.failures = known
            if self._description:
                self._describe(self._description)

    @property
    def secret(self) -> str | None:
        """The last secret of an isolated run."""
        return last_secret(self._description)

    def _describe(self, description: dict[str, Any]) -> None:
        self._lock.check()
        failures = {"failures": self.failures} if self.failures else {}
        self._description = {name: value for name, value in description.items() if name != "failures"} | failures
        write_text(self.folder / RUN, json.dumps(self._description, indent=2) + "\n")

    def finish(self, summary: Sequence[Mapping[str, Any]]) -> None:
        """Sort the rows of a finished run, and write its summary."""
        self._lock.check()
        self._rows.sort(lambda table: order_rows(table, self.config["detectors"]))
        write_text(self.folder / SUMMARY, json.dumps(summary, indent=2) + "\n")


def load_run(folder: Path) -> tuple[dict[str, Any], RowTable]:
    """Read a run: what ``run.json`` holds, and the rows, also of a run that is being played.

    Raises:
        ArgumentError: it is no folder of a run.
    """
    if not (folder / RUN).is_file():
        raise ArgumentError(f"folder must be the folder of a run, got {quote(str(folder))} without {RUN}.")
    description = _read_description(folder)
    try:
        with (folder / EPISODES).open(encoding="utf-8", newline="") as file:
            names = file.readline().rstrip("\r\n").split(",")
    except FileNotFoundError:
        names = []
    columns = {**COLUMNS, **dict.fromkeys([name for name in names if name not in COLUMNS], "float | None")}
    table = read_table(folder / EPISODES, columns)
    _check_once(table, folder)
    return description, table


def order_rows(table: RowTable, detectors: Sequence[str]) -> NDArray[np.int64]:
    """The places of the rows by detector, in this order of the detectors, then by episode."""
    places = {label: place for place, label in enumerate(detectors)}
    numbers = [places.get(label, len(places)) for label in table.column("detector")]
    return np.lexsort((table.column("episode"), np.array(numbers, np.int64)))


def last_secret(description: Mapping[str, Any]) -> str | None:
    """The last secret of an isolated run."""
    secrets = description.get("secrets")
    return str(secrets[-1]) if secrets else None


def _read_description(folder: Path) -> dict[str, Any]:
    """What ``run.json`` holds."""
    try:
        description = dict(json.loads((folder / RUN).read_text(encoding="utf-8")))
        config, made_by = description["config"], description["versions"]["usnet"]
        if not config.keys() >= set(JOINING) or not isinstance(made_by, str):
            raise ValueError
    except (ValueError, KeyError, TypeError, AttributeError):
        raise ArgumentError(f"out must be the folder of a run, got {str(folder)!r} with a broken {RUN}.") from None
    return description


def _join(folder: Path, description: Mapping[str, Any], asked: dict[str, Any]) -> tuple[dict[str, Any], list[str]]:
    """The arguments of the run of a folder with the detectors and episodes that join it.

    Returns:
        The arguments, and the labels of detectors that have failed in the run and are others now.

    Raises:
        ArgumentError: the run has other arguments, or was made by another version.
    """
    there: dict[str, Any] = description["config"]
    identities, joining = _read_identities(there), _read_identities(asked)
    failed = description.get("failures", {})
    different = sorted(
        name for name in there.keys() | asked.keys() if name not in JOINING and there.get(name) != asked.get(name)
    )
    changed = [label for label, identity in joining.items() if identities.get(label, identity) != identity]
    others = [
        f"in which detector {label!r} "
        f"{describe_difference(identities[label], joining[label]).removesuffix(f' of detector {label!r}')}"
        for label in changed
        if label not in failed
    ]
    if different == ["code"]:
        others.insert(0, f"with other code of {' and '.join(differing_keys(there.get('code'), asked.get('code')))}")
    elif different == ["recording"]:
        others.insert(0, _describe_tracks(there.get("recording"), str(asked.get("recording"))))
    elif different:
        others.insert(0, f"that has different values of {', '.join(different)}")
    if others:
        raise ArgumentError(
            f"out must be a new folder or the folder of the same run, got {str(folder)!r} with a run "
            f"{' and '.join(others)}."
        )
    if asked["episodes"] < there["episodes"]:
        raise ArgumentError(
            f"episodes must be at least {there['episodes']}, those of the run in {str(folder)!r}, "
            f"got {asked['episodes']}."
        )
    if (made_by := description["versions"]["usnet"]) != version("usnet"):
        raise ArgumentError(f"out must be a new folder, got {str(folder)!r} with a run of usnet {made_by}.")
    together = identities | joining
    joined = {"detectors": list(together), "identities": list(together.values()), "episodes": asked["episodes"]}
    return there | joined, changed


def _describe_tracks(there: str | None, asked: str) -> str:
    """Say how the tracks of a run differ from those that join it, by the SHA-256 of what was read."""
    if there is None:
        return "that does not say what its tracks held, because an earlier version wrote it"
    return f"of tracks with other content (SHA-256 {there:.12}… instead of {asked:.12}…)"


def _read_identities(config: Mapping[str, Any]) -> dict[str, Any]:
    """What each detector of a run is, by label."""
    return dict(zip(config["detectors"], config["identities"], strict=True))


def _check_once(table: RowTable, folder: Path) -> None:
    """Refuse rows that are there twice, which a summary would count twice."""
    labels = table.column("detector")
    order = order_rows(table, list(dict.fromkeys(labels)))
    ordered, episodes = labels[order], table.column("episode")[order]
    twice = np.flatnonzero((ordered[1:] == ordered[:-1]) & (np.diff(episodes) == 0))
    if len(twice):
        row = table[int(order[twice[0]])]
        raise ArgumentError(
            f"{EPISODES} must hold each episode of a detector once, got episode {row['episode']} of "
            f"{row['detector']!r} twice in {str(folder)!r}."
        )
