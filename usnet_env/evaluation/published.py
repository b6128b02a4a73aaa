"""The published rows of the suites, which ship with the package."""

from __future__ import annotations

import json
from importlib.resources import files
from pathlib import Path
from typing import Any

from usnet_env.config import ArgumentError, quote
from usnet_env.evaluation.result import EvaluationResult
from usnet_env.evaluation.suites import Suite, load_suite
from usnet_env.files import read_csv

#: Makes the swarms of published rows others than those of a suite's own seed. It is no draw: 60413, the seed of a
#: former suite, again and again.
PUBLISHED_ENTROPY = 0x60413604136041360413604136041300


def published_seed(suite: Suite) -> int:
    """The seed of the published rows of a suite."""
    return suite.seed + (PUBLISHED_ENTROPY << 32)


def results(suite: str) -> EvaluationResult:
    """The published rows of a suite of this package, to compare a run of yours with on the same swarms.

    ``results("field-v2").config["seed"]`` is the seed that such a run needs, and ``merge`` joins both.

    Raises:
        ArgumentError: there is no such suite, or no rows of it are published.

    >>> "reader" in results("paper")
    True
    """
    chosen = load_suite(suite)
    path: Any = _find_folder() / f"{chosen.name}-v{chosen.version}.csv.gz"
    if not path.is_file():
        raise ArgumentError(f"suite must be one whose rows are published, got {quote(suite)}.")
    rows = read_csv(path, compression="gzip", dtype={"error": object}).fillna({"error": ""})
    config = {"suite": chosen.label, "unit": chosen.unit, "cells": json.loads(chosen.model_dump_json())["cells"]}
    config |= {"detectors": list(rows.groupby("detector").exact.mean().sort_values(ascending=False).index)}
    return EvaluationResult(rows, config | {"episodes": int(rows.episode.max()) + 1, "seed": published_seed(chosen)})


def _find_folder() -> Any:
    """The folder of the rows in an installation, or else in the source tree."""
    installed = files("usnet_env.evaluation") / "results"
    return installed if installed.is_dir() else Path(__file__).parents[2] / "benchmarks" / "results" / "suites"
