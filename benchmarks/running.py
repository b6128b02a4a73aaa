"""What the benchmarks that play detectors share: a suite with columns of text, and where its rows lie."""

from __future__ import annotations

import argparse
import csv
import gzip
import io
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import make_dataclass
from pathlib import Path
from typing import Any

from usnet_env.evaluation.suite import Suite

from usnet_env.files import atomic_write
from usnet_env.progress import progress_bar

RESULTS = Path(__file__).parent / "results"
SEED = 2022  # of the first game; seeds below 1000 are for tuning

Cell = Mapping[str, Any]


def make_parser(words: str | None) -> argparse.ArgumentParser:
    """A parser of the command line whose ``--help`` shows the docstring of a script."""
    return argparse.ArgumentParser(description=words, formatter_class=argparse.RawDescriptionHelpFormatter)


def parse_or_list(parser: argparse.ArgumentParser, changes: Mapping[str, Any]) -> argparse.Namespace | None:
    """Parse the arguments of an ablation; with ``--list``, print ``what`` each change is, and return ``None``."""
    parser.add_argument("--list", action="store_true", help="list the changes and play nothing")
    arguments = parser.parse_args()
    if not arguments.list:
        return arguments
    for key, change in changes.items():
        print(f"{key or 'whole':18} {change.what}")
    return None


def answer_help(words: str | None) -> None:
    """End a script without arguments that was called with ``--help``, after its docstring, or with any other."""
    make_parser(words).parse_args()


def play_games(
    path: Path,
    games: Sequence[tuple[Cell, int]],
    play: Callable[[Cell, int], Mapping[str, Any]],
    values: Iterable[str],
    number: str = "seed",
) -> list[dict[str, str]]:
    """Play the games that a file lacks, and append their rows: the cell, the number of the game, the values.

    Games that the file holds are not played again: delete it to measure anew.

    Args:
        path: CSV file of the rows.
        games: each a cell, and the number of a game in it.
        play: returns the values of a game.
        values: their names.
        number: name of the column with the numbers.
    """
    names = tuple(games[0][0])
    kind = make_dataclass("Cell", [(name, "str") for name in names], frozen=True)
    columns = [(number, "int"), *((name, "str") for name in values)]
    row = make_dataclass("Row", columns, bases=(kind,), frozen=True)
    cells = {kind(*map(str, cell.values())): cell for cell, _ in games}

    def play_task(task: Sequence[tuple[Any, int]]) -> Iterator[Any]:
        for cell, game in task:
            found = play(cells[cell], game)
            yield row(**vars(cell), **{number: game}, **{name: str(value) for name, value in found.items()})

    with progress_bar("games") as progress:
        tasks = [[(kind(*map(str, cell.values())), game)] for cell, game in games]
        rows = Suite(kind, row, play_task, number=number).run(tasks, path, progress=progress)
    return [{name: str(value) for name, value in vars(made).items()} for made in rows]


def read_csv(path: Path) -> list[dict[str, str]]:
    """The rows of a file, which is compressed if its name ends in ``.gz``."""
    content = path.read_bytes()
    text = (gzip.decompress(content) if path.suffix == ".gz" else content).decode()
    return list(csv.DictReader(io.StringIO(text)))


def write_csv(path: Path, rows: Sequence[Mapping[str, Any]], columns: Sequence[str] | None = None) -> None:
    """Write the rows of a file at once.

    Args:
        path: the file; it is compressed if its name ends in ``.gz``; equal rows give equal bytes.
        rows: all of them.
        columns: of the file; ``None``: those of the first row.
    """
    text = io.StringIO()
    writer = csv.DictWriter(text, columns or list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    content = text.getvalue().encode()
    with atomic_write(path) as aside:
        aside.write_bytes(gzip.compress(content, mtime=0) if path.suffix == ".gz" else content)
