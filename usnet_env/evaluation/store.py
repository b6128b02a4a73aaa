"""A run's folder: its rows, its summary, and what made them. Every file appears whole, and a run can be continued."""

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
from usnet_env.files import atomic_write
from usnet_env.provenance import machine, versions

__all__ = ["COLUMNS", "RunStore", "write_text"]

RUN, EPISODES, SUMMARY = "run.json", "episodes.csv", "summary.json"

_WHOLE = ("episode", "swarm_seed", "detector_seed", "uavs", "heads", "rounds", "success", "exact")
COLUMNS = ("detector", "episode", "swarm_seed", "detector_seed", "uavs", "heads", *METRICS)

_SHARE_OF_TIME = 0.05  # rewriting the rows may take this share of a run


def write_text(path: Path, text: str) -> None:
    """Write a file so that it is either there in full or not at all."""
    with atomic_write(path) as aside, aside.open("w", encoding="utf-8", newline="") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())


def _value(column: str, text: str) -> Any:
    if column == "detector":
        return text
    if column in CLUSTER_METRICS and not text:
        return None
    return int(text) if column in _WHOLE else float(text)


class RunStore:
    """The folder of one run.

    Args:
        folder: made if need be.
        config: what was asked for, as plain JSON values; a folder that holds another config is refused.

    Raises:
        ArgumentError: the folder holds another run, or something that is none.
    """

    def __init__(self, folder: Path, config: Mapping[str, Any]) -> None:
        self.folder = folder
        self._config = json.loads(json.dumps(config))
        self._saved = time.monotonic()
        self._cost = 0.0
        if folder.exists() and not folder.is_dir():
            raise ArgumentError(f"out must be a folder, got the file {str(folder)!r}.")
        if (folder / RUN).exists():
            self._check()
            return
        if (folder / EPISODES).exists():
            raise ArgumentError(f"out must be a new folder or a run's, got {str(folder)!r} with rows but no {RUN}.")
        folder.mkdir(parents=True, exist_ok=True)
        about = {"config": self._config, "versions": versions(), "machine": machine()}
        write_text(folder / RUN, json.dumps(about, indent=2) + "\n")

    def _check(self) -> None:
        """Refuse to mix two runs."""
        try:
            about = json.loads((self.folder / RUN).read_text(encoding="utf-8"))
            config, made_by = dict(about["config"]), about["versions"]["usnet"]
        except (ValueError, KeyError, TypeError):
            raise ArgumentError(f"out must be a run's folder, got {str(self.folder)!r} with a broken {RUN}.") from None
        if config != self._config:
            names = config.keys() | self._config.keys()
            others = sorted(name for name in names if config.get(name) != self._config.get(name))
            raise ArgumentError(
                f"out must be a new folder or that of the same run, got {str(self.folder)!r}, whose run has another "
                f"{', '.join(others)}."
            )
        if made_by != version("usnet"):
            raise ArgumentError(
                f"out must be a new folder, got {str(self.folder)!r}, whose run was made by usnet {made_by}."
            )

    def rows(self) -> list[Row]:
        """The rows of the episodes that are finished.

        Raises:
            ArgumentError: the file is not what was written.
        """
        path = self.folder / EPISODES
        if not path.exists():
            return []
        try:
            with open(path, encoding="utf-8", newline="") as file:
                reader = csv.DictReader(file, strict=True)
                if tuple(reader.fieldnames or ()) != COLUMNS:
                    raise ValueError
                return [{name: _value(name, row[name]) for name in COLUMNS} for row in reader]
        except (ValueError, TypeError, csv.Error):
            raise ArgumentError(f"out must hold whole rows, got a broken {EPISODES} in {str(self.folder)!r}.") from None

    def due(self) -> bool:
        """Whether it is time to write rows: as often as writing takes a small share of the time."""
        return time.monotonic() - self._saved >= self._cost / _SHARE_OF_TIME

    def save_rows(self, rows: Iterable[Row]) -> None:
        """Write all rows."""
        begin = time.monotonic()
        text = io.StringIO()
        writer = csv.DictWriter(text, COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
        write_text(self.folder / EPISODES, text.getvalue())
        self._saved = time.monotonic()
        self._cost = self._saved - begin

    def save_summary(self, summary: Sequence[Mapping[str, Any]]) -> None:
        """Write the summary of a finished run."""
        write_text(self.folder / SUMMARY, json.dumps(summary, indent=2) + "\n")
