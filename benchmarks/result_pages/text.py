"""What the pages share: numbers with 95 % intervals, Markdown tables, the commands that made the rows."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

from usnet_env.evaluation.report import format_interval, format_markdown, mean_over_episodes
from usnet_env.evaluation.statistics import Interval, rate_interval

Row = Mapping[str, str]

#: Why intervals of rates of 0 and 100 % are wider than those of rates nearby: see ``rate_interval``.
SAME_SEEDS = (
    "Episodes with the same seed depend on each other and count as one group. At 0 % or 100 %, the interval uses the "
    "number of seeds as n, so it can be wider than the interval of a rate in between."
)
_EXTREME_RATE = re.compile(r"\b(?:100|0)\.0 % \(")

_ENTRY = re.compile(r"^\*\*[^\n]+\*\*: (`[^\n]+`)\n\n```shell\n(.*?)^```$", re.MULTILINE | re.DOTALL)
#: The commands of ``benchmarks/README.md`` by the files that they make: paths below results; a folder ends in ``/``.
COMMANDS: dict[tuple[str, ...], tuple[str, ...]] = {
    tuple(re.findall("`(.+?)`", files)): tuple(commands.splitlines())
    for files, commands in _ENTRY.findall(Path(__file__).parents[1].joinpath("README.md").read_text(encoding="utf-8"))
}

NOTICE = "<!-- Written by `python benchmarks/tables.py` from the rows in benchmarks/results. Do not edit. -->"


def number(interval: Interval, digits: int = 2) -> str:
    """A mean with its interval; the mean alone if all values were equal."""
    return format_interval(interval, f".{digits}f", short=True)


def share(interval: Interval) -> str:
    """A rate in percent with its interval."""
    mean, bounds = format_interval(interval, ".1f", 100).split(" ", 1)
    return f"{mean} % {bounds}"


def mean_of(rows: Iterable[Row], column: str, digits: int = 2, episode: str = "episode") -> str:
    """The mean of a column with the bootstrap's interval over episodes."""
    return number(mean_over_episodes(rows, column, episode), digits)


def cost_of(rows: Iterable[Row], digits: int = 3) -> str:
    """Mean J with its interval."""
    return mean_of(rows, "J", digits)


def share_of(rows: Iterable[Row], is_hit: Callable[[Row], bool], episode: str = "episode") -> str:
    """The share of hits in percent, with Wilson's interval; rows of one episode are a group."""
    known = list(rows)
    return share(rate_interval([float(is_hit(row)) for row in known], [row[episode] for row in known]))


def exact_of(rows: Iterable[Row], episode: str = "episode") -> str:
    """The share of exact episodes."""
    return share_of(rows, lambda row: float(row["exact"]) > 0, episode)


def table(header: Sequence[str], lines: Iterable[Sequence[str]]) -> str:
    """A Markdown table."""
    return "\n".join(format_markdown(header, lines, " --- "))


def commands_of(name: str) -> tuple[str, ...]:
    """The commands that make a file or folder below benchmarks/results; none if it has no entry."""
    return tuple(command for files, commands in COMMANDS.items() if name in files for command in commands)


def source(files: Sequence[str]) -> str:
    """Where the numbers of a page come from."""
    listed = ", ".join(f"`benchmarks/results/{name}`" for name in files)
    lines = [f"Raw rows: {listed}."]
    made = list(dict.fromkeys(command for name in files for command in commands_of(name)))
    if made:
        lines += ["", "```shell", *made, "```"]
    return "\n".join(lines)


def page(title: str, *parts: str, files: Sequence[str] = ()) -> str:
    """A page: notice, title, paragraphs; the first one explains the intervals of rates of 0 and 100 %, if any.

    Args:
        title: of the page.
        parts: the paragraphs.
        files: of the rows, if the page ends with them and the commands that made them.
    """
    end = ["## Raw rows and commands", source(files)] if files else []
    text = "\n\n".join([*parts[1:], *end])
    start = f"{parts[0]} {SAME_SEEDS}" if _EXTREME_RATE.search(text) and SAME_SEEDS not in text else parts[0]
    return "\n\n".join([NOTICE, f"# {title}", start, text]).strip() + "\n"


def picture(words: str, file: str) -> str:
    """A link to a picture in the folder of results; ``words`` describe the picture where it is not shown."""
    return f"![{words}](../../benchmarks/results/{file})"


def table_alone(markdown: str) -> str:
    """A file that holds tables and no heading, for pages that include it."""
    return f"{NOTICE}\n\n{markdown}\n"


def row_files(folder: Path, start: str) -> list[Path]:
    """The row files of a folder whose names start in this way, the paper's setting first: its name is the shortest."""
    return sorted(folder.glob(f"{start}*.csv"), key=lambda path: (len(path.name), path.name))


def demoted(markdown: str, levels: int = 1) -> str:
    """A report without its title, every other heading some levels deeper."""
    lines = markdown.strip().splitlines()
    if lines and lines[0].startswith("#"):
        lines = lines[1:]
    return "\n".join("#" * levels + line if line.startswith("#") else line for line in lines).strip()
