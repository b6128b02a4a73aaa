"""Keep an evaluation in a folder: rows, summary and config. Files are replaced atomically, and a run can be resumed."""

from __future__ import annotations

import csv
import io
import json
import os
import time
from collections.abc import Iterable, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

from usnet_env.config import ArgumentError
from usnet_env.evaluation.episode import Row
from usnet_env.evaluation.metrics import CLUSTER_METRICS, METRICS
from usnet_env.files import FileLock, atomic_write
from usnet_env.provenance import machine, versions

__all__ = ["COLUMNS", "RunStore", "write_text"]

RUN, EPISODES, SUMMARY = "run.json", "episodes.csv", "summary.json"

_INTEGERS = ("episode", "swarm_seed", "detector_seed", "uavs", "heads", "rounds", "success", "exact")
COLUMNS = ("detector", "episode", "swarm_seed", "detector_seed", "uavs", "heads", *METRICS)

_SHARE_OF_TIME = 0.05  # largest share of a run that may be spent on writing rows


def write_text(path: Path, text: str) -> None:
    """Write a text file atomically: a reader sees the whole new text, or the file as it was before."""
    with atomic_write(path) as aside, aside.open("w", encoding="utf-8", newline="") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())


def _parse_value(column: str, text: str) -> Any:
    if column == "detector":
        return text
    if column in CLUSTER_METRICS and not text:
        return None
    return int(text) if column in _INTEGERS else float(text)


class RunStore:
    """The folder of one run.

    Args:
        folder: the folder; it is created if it does not exist.
        config: the arguments of the run as JSON values; a folder with a different config is refused.

    While it is open no other process can use the folder. Use it in a ``with`` statement.

    Raises:
        ArgumentError: the folder holds a different run, files that are not a run, or a run that another process plays.
    """

    def __init__(self, folder: Path, config: Mapping[str, Any]) -> None:
        self.folder = folder
        self._config = json.loads(json.dumps(config))
        self._saved_at = time.monotonic()
        self._write_seconds = 0.0
        if folder.exists() and not folder.is_dir():
            raise ArgumentError(f"out must be a folder, got the file {str(folder)!r}.")
        self._lock = FileLock(folder / RUN)
        try:
            self._begun = (folder / RUN).exists()
            if self._begun:
                self._check_same_run()
            elif (folder / EPISODES).exists():
                raise ArgumentError(
                    f"out must be a new folder or the folder of a run, got {str(folder)!r} with rows but no {RUN}."
                )
        except BaseException:
            self._lock.release()
            raise

    def __enter__(self) -> RunStore:
        return self

    def __exit__(self, *_: object) -> None:
        self._lock.release()

    def _check_same_run(self) -> None:
        """Refuse the folder if its run has other arguments or was made by another version."""
        try:
            description = json.loads((self.folder / RUN).read_text(encoding="utf-8"))
            config, made_by = dict(description["config"]), description["versions"]["usnet"]
        except (ValueError, KeyError, TypeError):
            raise ArgumentError(
                f"out must be the folder of a run, got {str(self.folder)!r} with a broken {RUN}."
            ) from None
        if config != self._config:
            names = config.keys() | self._config.keys()
            different = sorted(name for name in names if config.get(name) != self._config.get(name))
            raise ArgumentError(
                f"out must be a new folder or the folder of the same run, got {str(self.folder)!r} with a run that has "
                f"different values of {', '.join(different)}."
            )
        if made_by != version("usnet"):
            raise ArgumentError(f"out must be a new folder, got {str(self.folder)!r} with a run of usnet {made_by}.")

    def load_rows(self) -> list[Row]:
        """Read the rows of all finished episodes.

        Raises:
            ArgumentError: the file is damaged or was edited.
        """
        path = self.folder / EPISODES
        if not path.exists():
            return []
        try:
            with open(path, encoding="utf-8", newline="") as file:
                reader = csv.DictReader(file, strict=True)
                if tuple(reader.fieldnames or ()) != COLUMNS:
                    raise ValueError
                return [{name: _parse_value(name, row[name]) for name in COLUMNS} for row in reader]
        except (ValueError, TypeError, csv.Error):
            raise ArgumentError(
                f"out must hold complete rows, got a broken {EPISODES} in {str(self.folder)!r}."
            ) from None

    def should_save(self) -> bool:
        """Return whether rows should be written now, so that writing takes at most a small share of the time."""
        return time.monotonic() - self._saved_at >= self._write_seconds / _SHARE_OF_TIME

    def save_rows(self, rows: Iterable[Row]) -> None:
        """Write all rows, replacing those in the file; the first call writes ``run.json`` as well.

        Raises:
            ArgumentError: the folder was removed during the run, or it cannot be written.
        """
        begin = time.monotonic()
        self._lock.check()
        if not self._begun:  # only now: a run that is refused before its first row leaves nothing
            description = {"config": self._config, "versions": versions(), "machine": machine()}
            write_text(self.folder / RUN, json.dumps(description, indent=2) + "\n")
            self._begun = True
        text = io.StringIO()
        writer = csv.DictWriter(text, COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
        write_text(self.folder / EPISODES, text.getvalue())
        self._saved_at = time.monotonic()
        self._write_seconds = self._saved_at - begin

    def save_summary(self, summary: Sequence[Mapping[str, Any]]) -> None:
        """Write the summary of a finished run."""
        self._lock.check()
        write_text(self.folder / SUMMARY, json.dumps(summary, indent=2) + "\n")
