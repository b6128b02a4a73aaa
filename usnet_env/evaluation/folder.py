"""The folder of a run: ``run.json`` with its arguments, and ``rows.csv``, to which each finished row is appended."""

from __future__ import annotations

import contextlib
import csv
import io
import json
import subprocess
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import numpy as np

from usnet_env.config import ArgumentError, quote
from usnet_env.evaluation.play import KEYS, METRICS, Row
from usnet_env.evaluation.tasks import EvaluationError
from usnet_env.files import read_csv, reserve_folder, write_text
from usnet_env.provenance import machine, versions

if TYPE_CHECKING:
    import pandas as pd

RUN, ROWS = "run.json", "rows.csv"
TEXTS = ("cell", "detector", "error")
#: The columns of every row; some environments and games have further metrics, before ``error``.
COLUMNS = (*KEYS, *METRICS, "error")


class RunFolder:
    """A folder that is open for further rows: a new one, or that of a run with the same arguments."""

    def __init__(self, folder: Path, config: dict[str, Any], columns: Sequence[str]) -> None:
        self.path = reserve_folder(folder) / ROWS
        self._file = self.path.open("a", encoding="utf-8", errors="backslashreplace", newline="")
        try:
            self._begin(folder, config, columns)
        except BaseException:
            self.close()
            raise

    def _begin(self, folder: Path, config: dict[str, Any], columns: Sequence[str]) -> None:
        """Lock the rows, and read what the folder holds before its files change."""
        import pandas as pd

        _lock(self._file, folder)
        self.rows = pd.DataFrame(columns=list(columns))
        build, builds = {"commit": _find_commit(), "versions": versions(), "machine": machine()}, list[Any]()
        lines = _read_whole_lines(self.path)
        if lines or (folder / RUN).exists():
            run, self.rows = read_run(folder)
            config = _join_arguments(folder, run["arguments"], config)
            builds = run.get("builds") or [{name: run.get(name) for name in build}]
        content = {"builds": builds + [build] * (build not in builds), "arguments": config}
        write_text(folder / RUN, json.dumps(content, indent=2) + "\n")
        self._file.truncate(len(lines))  # without a last line that was not written to its end
        names = self.rows.columns if lines else columns
        self._rows = csv.DictWriter(self._file, list(names), extrasaction="ignore", lineterminator="\n")
        if not lines:
            self._rows.writeheader()
            self._file.flush()

    def append(self, row: Row) -> None:
        """Write a row, so that it is in the file when this process is killed."""
        try:
            self._rows.writerow(row)
            self._file.flush()
        except OSError as error:  # the disk is full
            raise EvaluationError(f"{self.path} can't be written: {error.strerror}; the same call resumes.") from None

    def close(self) -> None:
        """Close the file."""
        with contextlib.suppress(OSError):  # of a row that couldn't be written
            self._file.close()


def _lock(file: IO[str], folder: Path) -> None:
    """Refuse rows that another run writes; the lock ends with its process. Windows and some disks have none."""
    try:
        import fcntl

        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise ArgumentError(f"out must be a folder that no other run writes now, got {quote(str(folder))}.") from None
    except (ImportError, OSError):
        return


def column_types(names: Iterable[str]) -> dict[str, Any]:
    """The types of columns with these names."""
    return {name: object if name in TEXTS else np.int64 if name in KEYS else np.float64 for name in names}


def _read_whole_lines(path: Path) -> bytes:
    """The rows that were written to their end."""
    data = path.read_bytes() if path.exists() else b""
    return data[: data.rfind(b"\n") + 1]


def read_run(folder: Path) -> tuple[dict[str, Any], pd.DataFrame]:
    """Read what ``run.json`` holds, and the rows; what is no folder of a run is refused."""
    try:
        run = json.loads((folder / RUN).read_text(encoding="utf-8"))
        lines = _read_whole_lines(folder / ROWS) or ",".join(COLUMNS).encode()
        names = lines.partition(b"\n")[0].decode().split(",")
        rows = read_csv(
            io.BytesIO(lines),
            dtype=column_types(names),
            keep_default_na=False,
            na_values={name: [""] for name in names if name not in TEXTS},
        )
        if not {"cells", "detectors", "episodes"} <= run["arguments"].keys():
            raise KeyError("arguments")
        rows = rows[[*COLUMNS[:-1], *(name for name in names if name not in COLUMNS), "error"]]
    except (OSError, ValueError, KeyError, TypeError) as error:
        reason = " ".join(str(getattr(error, "strerror", None) or error).split())
        raise ArgumentError(f"folder must be that of a run, got {quote(str(folder))}: {reason}.") from None
    return run, rows.drop_duplicates(["cell", "detector", "episode"], keep="last")  # a failed one was played again


def _join_arguments(folder: Path, old: dict[str, Any], new: dict[str, Any]) -> dict[str, Any]:
    """The arguments of a run and of a call that continues it, or extends it by cells, detectors or episodes."""
    joined = {
        "cells": old["cells"] | new["cells"],
        "detectors": list(dict.fromkeys([*old["detectors"], *new["detectors"]])),
        "episodes": max(old["episodes"], new["episodes"]),
    }
    for old_values, new_values in ((old | joined, new | joined), (old["cells"], new["cells"])):
        for name in old_values:
            if old_values[name] != new_values.get(name, old_values[name]):
                raise ArgumentError(
                    f"out must be a new folder, or that of a run with the same arguments, got {quote(str(folder))}, "
                    f"in which {name} is {quote(old_values[name])} instead of {quote(new_values[name])}."
                )
    return old | joined


def _find_commit() -> str | None:
    """The commit of the repository that holds this package, if it is in one."""
    command = ["git", "-C", str(Path(__file__).parent), "describe", "--always", "--dirty", "--abbrev=40"]
    try:
        return subprocess.run(command, capture_output=True, text=True, check=False).stdout.strip() or None
    except OSError:  # there is no git
        return None
