"""The folder of a run: ``run.json`` with its arguments, and ``rows.csv``, to which each finished row is appended."""

from __future__ import annotations

import csv
import errno
import io
import json
import os
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from usnet_env.config import ArgumentError, quote
from usnet_env.evaluation.errors import EvaluationError
from usnet_env.evaluation.play import KEYS, METRICS, Row
from usnet_env.files import atomic_write
from usnet_env.provenance import machine, versions

RUN, ROWS = "run.json", "rows.csv"
TEXTS = ("cell", "detector", "error")
#: The columns of every row; some environments and games have further metrics, before ``error``.
COLUMNS = (*KEYS, *METRICS, "error")
_JOINING = ("cells", "detectors", "episodes")  # the arguments that a later call may extend


class RunFolder:
    """A folder that is open for further rows.

    Args:
        folder: the folder; it is created, or holds an earlier part of the same run.
        config: the arguments of the run, as JSON holds them.
        columns: the columns of the rows.

    Raises:
        ArgumentError: the folder holds a run with other arguments, or it can't be written.
    """

    def __init__(self, folder: Path, config: Mapping[str, Any], columns: Sequence[str]) -> None:
        self.path = folder / ROWS
        self.rows = pd.DataFrame(columns=list(columns))
        self.config = dict(config)
        about: dict[str, Any] = {}
        try:
            folder.mkdir(parents=True, exist_ok=True)
            if (folder / RUN).exists():
                about, self.rows = read_run(folder)
                self.config = _join(folder, about["arguments"], config)
            self._columns = list(self.rows.columns if len(self.rows) else columns)
            self._file = _open_rows(self.path, self._columns)
        except OSError as error:
            reason = error.strerror or error
            raise ArgumentError(
                f"out must be a folder that can be written, got {quote(str(folder))}: {reason}."
            ) from None
        about = {
            "versions": versions(),
            "machine": machine(),
            "commit": _find_commit(),
            **about,
            "arguments": self.config,
        }
        with atomic_write(folder / RUN) as aside:
            aside.write_text(json.dumps(about, indent=2) + "\n", encoding="utf-8")

    def append(self, row: Row) -> None:
        """Write a row, so that it is in the file when this process is killed.

        Raises:
            EvaluationError: it can't be written, for example because the disk is full.
        """
        line = io.StringIO()
        csv.writer(line, lineterminator="\n").writerow(row.get(name) for name in self._columns)
        try:
            data = line.getvalue().encode("utf-8", "backslashreplace")
            if os.write(self._file, data) < len(data):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        except OSError as error:
            raise EvaluationError(f"{self.path} can't be written: {error.strerror}; the same call resumes.") from None

    def close(self) -> None:
        """Close the file."""
        os.close(self._file)


def _open_rows(path: Path, columns: Sequence[str]) -> int:
    """Open the file of rows at its end, without a last line that was not written to its end."""
    file = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
    data = path.read_bytes()
    whole = data.rfind(b"\n") + 1
    os.truncate(file, whole)
    os.lseek(file, whole, os.SEEK_SET)
    if not whole:
        os.write(file, (",".join(columns) + "\n").encode())
    return file


def read_run(folder: Path) -> tuple[dict[str, Any], pd.DataFrame]:
    """Read what ``run.json`` holds, and the rows; a last line that was not written to its end is left out.

    Raises:
        ArgumentError: the folder holds no run, or a broken file.
    """
    try:
        about = json.loads((folder / RUN).read_text(encoding="utf-8"))
        data = (folder / ROWS).read_bytes() if (folder / ROWS).exists() else b""
        whole = data[: data.rfind(b"\n") + 1]
        names = whole.partition(b"\n")[0].decode().split(",") if whole else list(COLUMNS)
        numbers = [name for name in names if name not in TEXTS]
        rows = pd.read_csv(
            io.BytesIO(whole or ",".join(names).encode()),
            dtype={name: "category" if name in TEXTS else np.int64 if name in KEYS else np.float64 for name in names},
            keep_default_na=False,
            na_values={name: [""] for name in numbers},
            float_precision="round_trip",
        )
        if not {"cells", "detectors"} <= about["arguments"].keys() or not set(COLUMNS) <= set(names):
            raise KeyError("arguments")
    except (OSError, ValueError, KeyError, TypeError) as error:
        reason = " ".join(str(getattr(error, "strerror", None) or error).split())
        raise ArgumentError(f"folder must be that of a run, got {quote(str(folder))}: {reason}.") from None
    rows = rows.astype(dict.fromkeys(TEXTS, object))
    return about, rows.drop_duplicates(["cell", "detector", "episode"], keep="last")  # a failed one was played again


def _join(folder: Path, known: dict[str, Any], asked: Mapping[str, Any]) -> dict[str, Any]:
    """The arguments of a run and of a call that continues or extends it."""
    fixed = [*dict.fromkeys(name for name in (*known, *asked) if name not in _JOINING)]
    differing = [(name, known.get(name), asked.get(name)) for name in fixed if known.get(name) != asked.get(name)]
    for cell, settings in asked["cells"].items():
        before = known["cells"].get(cell, settings)
        differing += [(cell, before, settings)] if before != settings else []
    if differing:
        name, before, now = differing[0]
        raise ArgumentError(
            f"out must be a new folder, or that of a run with the same arguments, got {quote(str(folder))}, "
            f"in which {name} is {quote(before)} instead of {quote(now)}."
        )
    return {
        **known,
        "cells": known["cells"] | asked["cells"],
        "detectors": list(dict.fromkeys([*known["detectors"], *asked["detectors"]])),
        "episodes": max(known["episodes"], asked["episodes"]),
    }


def _find_commit() -> str | None:
    """The commit of the repository that holds this package, if it is in one."""
    command = ["git", "-C", str(Path(__file__).parent), "describe", "--always", "--dirty", "--abbrev=40"]
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return None
