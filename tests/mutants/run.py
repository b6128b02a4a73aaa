"""Apply deliberate errors to a copy of the project, one at a time, and report which test finds each.

    python tests/mutants/run.py                    # all mutants
    python tests/mutants/run.py --only 42 43       # some of them; --write merges their rows into the table
    python tests/mutants/run.py --write            # also write tests/mutants/mutants.md

The exit status is 1 if a mutant survives its tests or its text no longer occurs exactly once.
"""

from __future__ import annotations

import argparse
import ast
import os
import re
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import yaml

ROOT = Path(__file__).resolve().parents[2]
LIST = Path(__file__).with_name("mutants.yaml")
TABLE = Path(__file__).with_name("mutants.md")

SURVIVES, PENDING = "SURVIVES", "pending"
_COPIED = ("usnet_env", "detectors", "tests", "examples", "docs", "benchmarks")
_COPIED_FILES = ("pyproject.toml", "README.md")
_SECONDS = 3600  # time limit of the tests of one mutant
_HEADER = """# Mutants and the tests that find them

`python tests/mutants/run.py --write` makes this table from `mutants.yaml`. A mutant is a deliberate error in the code;
it is killed if one of its tests fails. Pending mutants are not run.

| number | mutant | file | killed by |
| --- | --- | --- | --- |
"""


@dataclass(frozen=True)
class Mutant:
    """One deliberate error; the fields are explained in mutants.yaml."""

    number: int
    description: str
    file: str
    old: str
    new: str
    tests: tuple[str, ...]
    pending: bool = False

    def count_old(self) -> int:
        """How often the old text occurs in the file; 0 if there is no such file."""
        path = ROOT / self.file
        return path.read_text(encoding="utf-8").count(self.old) if path.is_file() and self.old else 0

    def missing_tests(self) -> list[str]:
        """The test files and node ids that do not exist."""
        return [node for node in self.tests if not _exists(node)]


def _exists(node: str) -> bool:
    name, _, function = node.partition("::")
    path = ROOT / name
    if not function:
        return path.exists()
    if not path.is_file():
        return False
    functions = {item.name for item in ast.parse(path.read_text(encoding="utf-8")).body if hasattr(item, "name")}
    return function in functions


def read_mutants() -> list[Mutant]:
    """All mutants of mutants.yaml, by number."""
    entries = yaml.safe_load(LIST.read_text(encoding="utf-8"))
    return sorted((Mutant(**entry | {"tests": tuple(entry["tests"])}) for entry in entries), key=lambda m: m.number)


def copy_project(target: Path) -> None:
    """Copy what the tests need; compiled files come along and keep their times, so that they stay valid."""
    for name in _COPIED:
        if (ROOT / name).is_dir():
            ignored = shutil.ignore_patterns("_build", "envs" if name == "docs" else "_build", "*.nbc.tmp*")
            shutil.copytree(ROOT / name, target / name, ignore=ignored)
    for name in _COPIED_FILES:
        shutil.copy2(ROOT / name, target / name)


def run_mutant(mutant: Mutant) -> str:
    """Apply a mutant to a copy of the project and run its tests.

    Returns:
        The node id of the first test that fails, or :data:`SURVIVES`.

    Raises:
        RuntimeError: the old text does not occur exactly once, or the tests could not be run.
    """
    if (count := mutant.count_old()) != 1:
        raise RuntimeError(f"mutant {mutant.number}: the old text occurs {count} times in {mutant.file}, not once.")
    if missing := mutant.missing_tests():
        raise RuntimeError(f"mutant {mutant.number}: there is no test {', '.join(missing)}.")
    with tempfile.TemporaryDirectory(prefix="mutant-") as folder:
        target = Path(folder)
        copy_project(target)
        changed = target / mutant.file
        changed.write_text(changed.read_text(encoding="utf-8").replace(mutant.old, mutant.new), encoding="utf-8")
        words = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", "--no-header", "-rfE"]
        words += ["-m", "not slow", *mutant.tests]
        environment = {key: value for key, value in os.environ.items() if not key.startswith("PYTEST_")}
        environment |= {"PYTHONPATH": folder, "OMP_NUM_THREADS": "1"}
        environment.pop("NUMBA_CACHE_DIR", None)
        try:
            run = subprocess.run(
                words, cwd=folder, env=environment, capture_output=True, text=True, timeout=_SECONDS, check=False
            )
        except subprocess.TimeoutExpired:
            raise RuntimeError(f"mutant {mutant.number}: the tests took more than {_SECONDS} seconds.") from None
    if run.returncode == 0:
        return SURVIVES
    failed = re.search(r"^(?:FAILED|ERROR) (\S+::\S+|\S+\.py)", run.stdout, re.MULTILINE)
    if run.returncode != 1 or failed is None:
        raise RuntimeError(f"mutant {mutant.number}: pytest ended with {run.returncode}:\n{run.stdout}\n{run.stderr}")
    return failed[1]


def table(mutants: list[Mutant], killers: dict[int, str]) -> str:
    """The Markdown table of all mutants; ``killers`` holds the result of each number that was run."""
    rows = []
    for mutant in mutants:
        killer = PENDING if mutant.pending else killers.get(mutant.number, "not run")
        shown = killer if killer in (PENDING, SURVIVES, "not run") else f"`{killer.replace('|', chr(92) + '|')}`"
        rows.append(f"| {mutant.number} | {mutant.description} | `{mutant.file}` | {shown} |\n")
    return _HEADER + "".join(rows)


def read_table() -> dict[int, str]:
    """The results that the committed table holds, by number."""
    if not TABLE.is_file():
        return {}
    rows = re.findall(r"^\| (\d+) \|.*\| (.+) \|$", TABLE.read_text(encoding="utf-8"), re.MULTILINE)
    known = {int(number): killer.strip("`").replace("\\|", "|") for number, killer in rows}
    return {number: killer for number, killer in known.items() if killer not in (PENDING, "not run")}


def main(arguments: list[str] | None = None) -> int:
    """Run the mutants; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", type=int, nargs="+", metavar="N", help="numbers of the mutants to run")
    parser.add_argument("--write", action="store_true", help=f"write {TABLE.relative_to(ROOT)} after each mutant")
    options = parser.parse_args(arguments)
    mutants = read_mutants()
    if unknown := set(options.only or ()) - {mutant.number for mutant in mutants}:
        parser.error(f"argument --only: there is no mutant {', '.join(map(str, sorted(unknown)))}")
    wanted = [
        mutant for mutant in mutants if not mutant.pending and (not options.only or mutant.number in options.only)
    ]
    killers = read_table() if options.only else {}
    good = True
    for mutant in wanted:
        try:
            killers[mutant.number] = run_mutant(mutant)
        except RuntimeError as error:
            killers.pop(mutant.number, None)
            print(error, file=sys.stderr)
            good = False
            continue
        good &= killers[mutant.number] != SURVIVES
        print(f"{mutant.number:3} {killers[mutant.number]}  ({mutant.description})", flush=True)
        if options.write:
            TABLE.write_text(table(mutants, killers), encoding="utf-8")
    if options.write:
        TABLE.write_text(table(mutants, killers), encoding="utf-8")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
