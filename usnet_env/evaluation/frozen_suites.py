"""Frozen suites: lists of environments that detectors are compared on, each kept in a YAML file with a version.

A file of ``usnet_env/evaluation/suites`` never changes without a new version, so a result on ``controls`` version 1
means the same wherever it was measured. A file of your own works the same way.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256
from importlib.resources import files
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import yaml
from pydantic import Field, field_validator

from usnet_env.config import ArgumentError, Config, format_count, quote, unknown_name
from usnet_env.evaluation import tables
from usnet_env.evaluation.environments import check_labelled, make_environment
from usnet_env.evaluation.errors import EvaluationError
from usnet_env.evaluation.identity import describe
from usnet_env.evaluation.metrics import RATES
from usnet_env.evaluation.report import format_interval, format_latex, format_markdown
from usnet_env.evaluation.result import EvaluationResult, Results, Summary, summarise
from usnet_env.evaluation.runner import evaluate
from usnet_env.evaluation.statistics import Interval
from usnet_env.evaluation.store import COLUMNS, KEYS, RUN
from usnet_env.evaluation.suite_folder import FAILURES, SUITE, read_failures, read_suite, write_failures, write_suite
from usnet_env.evaluation.table import Columns, RowTable
from usnet_env.files import as_path
from usnet_env.progress import part_of

if TYPE_CHECKING:
    from pandas import DataFrame
    from rich.table import Table

_FOLDER = files("usnet_env.evaluation") / "suites"
_CELL = re.compile(r"\w[\w .,=+-]*")  # a folder of a run has the name of its cell


class Cell(Config):
    """One setting: an environment and its arguments."""

    env: str
    arguments: dict[str, Any] = Field(default_factory=dict)


class FrozenSuite(Config):
    """A list of settings, and the seeds of their episodes."""

    name: str = Field(description="name of the file, without its suffix")
    digest: str = Field(description="SHA-256 of the file, as 64 hexadecimal digits")
    version: Annotated[int, Field(ge=1, le=10_000)] = Field(description="it grows with every change of the file")
    purpose: str = Field(description="what the suite is for, in one sentence")
    episodes: Annotated[int, Field(ge=1, le=1_000_000)] = Field(description="episodes of a cell in published tables")
    seed: Annotated[int, Field(ge=1000, lt=2**63)] = Field(description="seed of published tables")
    tuning_seed: Annotated[int, Field(ge=0, lt=1000)] = Field(
        description="seed for tuning a detector; the swarms of the two seeds have nothing in common"
    )
    cells: Annotated[dict[str, Cell], Field(min_length=1)] = Field(description="the settings by name")

    @field_validator("cells", mode="before")
    @classmethod
    def _check_names(cls, cells: Any) -> Any:
        for name in cells if isinstance(cells, Mapping) else ():
            if not isinstance(name, str) or not _CELL.fullmatch(name) or name in (SUITE, FAILURES):
                raise ArgumentError(
                    "cells must have names of letters, digits, spaces and '_.,=+-' that begin with a letter or a "
                    f"digit, got {quote(name)}."
                )
        return cells

    @property
    def label(self) -> str:
        """Name and version."""
        return f"{self.name} (version {self.version})"


def list_suites() -> dict[str, FrozenSuite]:
    """The suites of this package, by name."""
    return {name: load_suite(name) for name in _list_names()}


def _list_names() -> list[str]:
    return sorted(entry.name.removesuffix(".yaml") for entry in _FOLDER.iterdir() if entry.name.endswith(".yaml"))


def load_suite(suite: str | PathLike[str]) -> FrozenSuite:
    """Read a suite.

    Args:
        suite: the name of a suite of this package, or the path of a YAML file.

    Raises:
        ArgumentError: there is no such suite, or the file does not describe one; the message names its first fault.
    """
    path = as_path("suite", suite)
    if path.suffix in (".yaml", ".yml"):
        name, source = path.stem, path
    else:
        name, source = str(suite), _FOLDER / f"{suite}.yaml"  # type: ignore[assignment]
        if not source.is_file():
            raise unknown_name("suite", str(suite), _list_names())
    try:
        data = source.read_bytes()
        content = yaml.safe_load(data)
    except (OSError, yaml.YAMLError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else " ".join(str(error).split())
        raise ArgumentError(f"suite must be a YAML file that can be read, got {quote(str(suite))}: {reason}.") from None
    text = f"in {path.name}"
    if not isinstance(content, dict) or not isinstance(content.get("cells"), dict) or not content["cells"]:
        raise ArgumentError(f"suite must be a YAML file with a mapping of cells, got {quote(content)} {text}.")
    shared, env = content.pop("arguments", None) or {}, content.pop("env", "USNET/MultiCluster-v0")
    cells = {}
    for cell, own in {"arguments": shared, **content.pop("cells")}.items():
        if not isinstance(own or {}, dict):
            raise ArgumentError(f"{cell} must map names to arguments, got {quote(own)} {text}.")
        if cell != "arguments":
            arguments = {**shared, **(own or {})}
            with _name_cell(cell, f"of {path.name}"):
                cells[cell] = Cell(env=arguments.pop("env", env), arguments=arguments)
    content |= {"name": name, "digest": sha256(data).hexdigest(), "cells": cells}
    if missing := sorted(FrozenSuite.model_fields.keys() - content):
        raise ArgumentError(f"suite must have {', '.join(missing)}, got none {text}.")
    return FrozenSuite(**content)


@contextmanager
def _name_cell(name: str, where: str) -> Iterator[None]:
    """Name the cell in the message of an argument that is refused."""
    try:
        yield
    except ArgumentError as error:
        raise ArgumentError(f"{str(error).removesuffix('.')}, in the cell {quote(name)} {where}.") from None


def evaluate_suite(
    suite: str | PathLike[str] | FrozenSuite,
    detector: Any,
    *,
    cells: Sequence[str] | None = None,
    episodes: int | None = None,
    seed: int | None = None,
    isolate: bool = True,
    out: str | PathLike[str] | None = None,
    **how: Any,
) -> SuiteResult:
    """Evaluate detectors in every cell of a suite.

    Args:
        suite: a name, the path of a YAML file, or what :func:`load_suite` returns.
        detector: as of :func:`usnet_env.evaluate`.
        cells: names of the cells to play; ``None`` for all.
        episodes: number of episodes of each cell; ``None`` for that of the suite.
        seed: seed of the episodes; ``None`` for that of the suite's published tables.
        isolate: whether each detector plays in a process of its own without an environment.
        out: folder; each cell is a run in a folder of its own, which the same call resumes.
        how: further arguments of :func:`usnet_env.evaluate`.

    Returns:
        The results of all cells. A detector that fails in a cell has no result there, and the result's ``failures``
        say why.

    Raises:
        ArgumentError: an argument was refused, by the suite or by :func:`usnet_env.evaluate`.
        EvaluationError: no process could start.
    """
    chosen = suite if isinstance(suite, FrozenSuite) else load_suite(suite)
    if cells is not None and (isinstance(cells, str) or not isinstance(cells, Sequence) or not cells):
        raise ArgumentError(f"cells must be a list of at least one name, or None for all, got {quote(cells)}.")
    for name in cells or ():
        if name not in chosen.cells:
            raise unknown_name("cells", name, chosen.cells)
    for name in ("env", "env_kwargs"):
        if name in how:
            raise ArgumentError(f"{name} must not be given, because the suite gives it, got {quote(how[name])}.")
    for name, cell in chosen.cells.items():  # a fault in the last cell should not end a run of hours
        with (
            _name_cell(name, f"of the suite {chosen.name}"),
            closing(make_environment(cell.env, cell.arguments)) as env,
        ):
            check_labelled(env)
    folder = None if out is None else as_path("out", out)
    results: dict[str, EvaluationResult] = {}
    failures = {} if folder is None else read_failures(folder)
    played = list(dict.fromkeys(cells or chosen.cells))
    for number, name in enumerate(played, 1):
        cell, failed, asked = chosen.cells[name], {}, chosen.episodes if episodes is None else episodes
        try:
            with part_of(f"cell {number} of {len(played)}: {name}"):
                results[name] = evaluate(
                    cell.env,
                    detector,
                    episodes=asked,
                    seed=chosen.seed if seed is None else seed,
                    env_kwargs=cell.arguments,
                    isolate=isolate,
                    out=None if folder is None else folder / name,
                    **how,
                )
        except EvaluationError as error:
            if not error.started:
                raise
            failed = dict(error.failures)
            if error.result is not None:
                results[name] = error.result
        finally:  # not before: a call that is refused leaves nothing
            if folder is not None and (folder / name / RUN).exists():
                write_suite(folder, chosen)
        # Failures of an earlier call stay until the detector has played all episodes.
        summary = results[name].summary if name in results else []
        complete = {entry["detector"] for entry in summary if entry["episodes"] >= asked}
        kept = {label: text for label, text in failures.pop(name, {}).items() if label not in complete}
        if kept | failed:
            failures[name] = kept | failed
        if folder is not None:
            write_failures(folder, failures)
    return SuiteResult(chosen, results, {cell: failures[cell] for cell in played if cell in failures})


def _restore_suite(folder: Path) -> FrozenSuite | None:
    """The suite that was played last in a folder; ``None`` if an earlier version wrote it."""
    fields = read_suite(folder)
    if fields is None:
        return None
    try:
        return FrozenSuite(**fields | {"cells": {name: Cell(**cell) for name, cell in fields["cells"].items()}})
    except (ArgumentError, AttributeError, KeyError, TypeError):
        raise ArgumentError(f"folder must hold a {SUITE} of a suite, got another one in {str(folder)!r}.") from None


def _find_suite(runs: Mapping[str, EvaluationResult], kept: FrozenSuite | None) -> FrozenSuite | None:
    """The suite that has these runs as cells, with the same arguments: the one that the folder names.

    Without it, or if other suites were played in the folder too, a suite of this package, one with their seed first.
    """

    def has(suite: FrozenSuite, name: str, config: Mapping[str, Any]) -> bool:
        cell = suite.cells.get(name)
        if cell is None or cell.env.rpartition(":")[2] != config["env"]:
            return False
        return bool(json.loads(json.dumps(describe(cell.arguments))) == config["env_kwargs"])

    configs = {name: run.config for name, run in runs.items()}
    known = [each for each in (kept, *list_suites().values()) if each is not None]
    found = [each for each in known if all(has(each, *one) for one in configs.items())]
    seeds = {config["seed"] for config in configs.values()}
    return min(found, key=lambda suite: (suite is not kept, not {suite.seed, suite.tuning_seed} & seeds), default=None)


@dataclass(frozen=True, repr=False)
class SuiteResult(Results):
    """The results of a suite.

    Args:
        suite: the suite; ``None`` if :meth:`load` cannot tell it from a folder of an earlier version.
        results: the result of each cell that was played.
        failures: why a detector has no result in a cell, by cell and by the label of the detector.
    """

    suite: FrozenSuite | None
    results: Mapping[str, EvaluationResult]
    failures: Mapping[str, Mapping[str, str]]

    @classmethod
    def load(cls, folder: str | PathLike[str], suite: str | PathLike[str] | FrozenSuite | None = None) -> SuiteResult:
        """Read the folder of a suite that was played, finished or not.

        Args:
            folder: the folder.
            suite: as of :func:`evaluate_suite`; ``None``: the suite that the folder names, or a suite of this package
                whose cells are the runs of the folder. If there is none, the cells are all runs of the folder, in the
                order of their names.

        Raises:
            ArgumentError: the folder holds no run of a cell, or a file in it is broken.
        """
        root = as_path("folder", folder)
        chosen = load_suite(suite) if isinstance(suite, str | PathLike) else suite
        found = sorted(path.parent.name for path in root.glob(f"*/{RUN}")) if chosen is None else chosen.cells
        results = {name: EvaluationResult.load(root / name) for name in found if (root / name).is_dir()}
        if not results:
            of = "a suite" if chosen is None else f"the suite {chosen.name}"
            raise ArgumentError(f"folder must hold runs of {of}, got {quote(str(root))}.")
        if chosen is None and (chosen := _find_suite(results, _restore_suite(root))):
            results = {name: results[name] for name in chosen.cells if name in results}
        known = read_failures(root)
        failures = {}
        for cell in chosen.cells if chosen else dict.fromkeys([*results, *known]):
            run = results.get(cell)
            played = set() if run is None else set(run)
            own = {label: why for label, why in known.get(cell, {}).items() if label not in played}
            if own := own | ({} if run is None else run.failures):
                failures[cell] = own
        return cls(chosen, {name: run for name, run in results.items() if run.summary}, failures)

    @property
    def label(self) -> str:
        """Name and version of the suite."""
        return "suite" if self.suite is None else self.suite.label

    def __repr__(self) -> str:
        return f"<SuiteResult of {self._title}, {format_count(len(self.detectors), 'detector')}>"

    def _repr_html_(self) -> str:
        """The ranking, the table of the cells, what has not been played and the failures, for a notebook."""
        ranking, cells = tables.html_table(self.summary, self._title), tables.html_cells(*self._table("exact"))
        notes = [f"{cell}: {why}" for cell, own in self.failures.items() for why in own.values()]
        return ranking + cells + tables.html_notes([*self._list_gaps(), *notes])

    @property
    def _title(self) -> str:
        """The suite and the number of its cells that have a result."""
        total = len(self._cells if self.suite is None else self.suite.cells)
        cells = format_count(total, "cell")
        return f"{self.label}, {cells if len(self.results) == total else f'{len(self.results)} of {cells}'}"

    def _list_gaps(self) -> list[str]:
        """What has not been played, in one sentence for the cells, and one for the episodes of each other cell."""
        cells = [] if self.suite is None else list(self.suite.cells)
        absent = [name for name in cells if name not in self._cells]
        have = "has" if len(absent) == 1 else "have"
        lack = f"{len(absent)} of {format_count(len(cells), 'cell')} {have} not been played: {', '.join(absent)}."
        own = {name: tables.describe_gap(result.summary, result.config) for name, result in self.results.items()}
        return [lack] * bool(absent) + [f"{name}: {gap}" for name, gap in own.items() if gap]

    def list_results(self) -> list[EvaluationResult]:
        """The result of each cell."""
        return list(self.results.values())

    @property
    def _cells(self) -> list[str]:
        """The cells that were played, those in which all detectors failed included."""
        order = self.suite.cells if self.suite else [*self.results, *self.failures]
        return [name for name in dict.fromkeys(order) if name in self.results or name in self.failures]

    @cached_property
    def detectors(self) -> list[str]:
        """The labels of all detectors."""
        return list(dict.fromkeys(entry["detector"] for each in self.results.values() for entry in each.summary))

    def cell(self, name: str, detector: str, metric: str = "exact") -> Interval | None:
        """The mean of a metric in a cell, with its interval; ``None`` where the detector has no result.

        Raises:
            ArgumentError: there is no such metric, or no result of such a cell.
        """
        if name not in self._cells:
            raise unknown_name("name", name, self._cells)
        result = self.results.get(name)
        if result is None:
            return None
        if metric not in self._columns or metric in KEYS:
            raise unknown_name("metric", metric, [each for each in self._columns if each not in KEYS])
        if detector not in result or metric not in result[detector]:
            return None
        return Interval(**result[detector][metric])

    @cached_property
    def _columns(self) -> Columns:
        """The columns of the rows of all cells; a cell may lack those that only some environments have."""
        found = dict.fromkeys(name for result in self.results.values() for name in result.rows.columns)
        return {**COLUMNS, **dict.fromkeys([name for name in found if name not in COLUMNS], "float | None")}

    @cached_property
    def summary(self) -> Summary:
        """The mean of each metric over all episodes of all cells, for each detector that has a result in every cell.

        It has the form of ``EvaluationResult.summary``. Cells with the same number of episodes have the same weight.
        """
        complete = [each for each in self.detectors if all(self.cell(name, each, "J") for name in self._cells)]
        lacking = dict.fromkeys(name for name in self._columns if name not in COLUMNS)
        pooled = RowTable(self._columns, (lacking | row for result in self.results.values() for row in result.rows))
        return [entry for entry in summarise(pooled) if entry["detector"] in complete]

    def ranking(self) -> Table:
        """The detectors by their mean J over all cells (in recorded tracks F1), as a table for 80 columns."""
        return tables.ranking_table(self.summary, self._title)

    def to_markdown(self, metric: str = "exact") -> str:
        """A table with a line for each cell and a column for each detector: the mean of a metric and its interval.

        Where all values are equal, or there is one, the mean has no interval.

        Raises:
            ArgumentError: there is no such metric.
        """
        header, lines = self._table(metric)
        return "\n".join([*format_markdown(header, lines), ""])

    def to_latex(self, metric: str = "exact") -> str:
        """The table of :meth:`to_markdown` as a ``tabular`` for LaTeX's booktabs."""
        header, lines = self._table(metric)
        return "\n".join([*format_latex(header, lines), ""])

    def _table(self, metric: str) -> tuple[list[str], list[list[str]]]:
        """The heading and the lines of a table of a metric."""
        scale, form, unit = (100.0, ".0f", " %") if metric in RATES else (1.0, ".2f", "")

        def show(value: Interval | None) -> str:
            return "–" if value is None else format_interval(value, form, scale, short=True) + unit

        lines = [[name, *(show(self.cell(name, each, metric)) for each in self.detectors)] for name in self._cells]
        means = {
            entry["detector"]: Interval(**entry["metrics"][metric])
            for entry in self.summary
            if metric in entry["metrics"]
        }
        lines.append(["all cells", *(show(means.get(each)) for each in self.detectors)])
        counts = sorted({entry["episodes"] for each in self.results.values() for entry in each.summary}) or [0]
        n = f"{counts[0]}" if len(counts) == 1 else f"{counts[0]} to {counts[-1]}"
        name = tables.objective(self.summary).name if metric == "J" and self.summary else metric
        suite = "suite" if self.suite is None else self.suite.name
        return [f"{suite}, {name}, n = {n} a cell", *self.detectors], lines

    def to_frame(self) -> DataFrame:
        """The rows of all cells as a data frame of pandas, with a column ``cell``.

        Raises:
            ArgumentError: pandas is not installed, or there is no result.
        """
        frames = [result.to_frame().assign(cell=name) for name, result in self.results.items()]
        if not frames:
            raise ArgumentError("to_frame must have the result of a cell, got none.")
        from pandas import concat  # after to_frame, which refuses without it

        return concat(frames, ignore_index=True)
