"""Write every published table from the committed rows: docs/results, and README.md's table.

    python benchmarks/tables.py            # write what differs
    python benchmarks/tables.py --check    # write nothing; exit with 1 and name the files that differ
    python benchmarks/tables.py --figures  # also draw the pictures that are made from the rows of several files

No number of these pages is written by hand. README.md has one table, between ``<!-- results:begin -->`` and
``<!-- results:end -->``; its other text is not touched.
"""

from __future__ import annotations

import sys
from pathlib import Path

from result_pages import (
    clusters,
    confirmation,
    cores,
    decoys,
    index,
    learned,
    literature,
    multiagent,
    p1,
    paper_tier,
    purity,
    real_tracks,
    rounds,
    speed,
    strategies,
    suites,
    thresholds,
    tiers,
)
from result_pages.text import table_alone
from running import make_parser

from usnet_env.drawing import write_figure
from usnet_env.files import atomic_write

ROOT = Path(__file__).parents[1]
PAGES = {
    "docs/results/index.md": index.text,
    "docs/results/paper_tier.md": paper_tier.text,
    "docs/results/follow_mixture.md": tiers.text,
    "docs/results/follow_mixture_cells.md": tiers.cells_text,
    "docs/results/follow_mixture_cores.md": cores.text,
    "docs/results/follow_mixture_thresholds.md": thresholds.text,
    "docs/results/decoys.md": decoys.text,
    "docs/results/strategies.md": strategies.text,
    "docs/results/p1.md": p1.text,
    "docs/results/rounds.md": rounds.text,
    "docs/results/purity.md": purity.text,
    "docs/results/learned.md": learned.text,
    "docs/results/multiagent.md": multiagent.text,
    "docs/results/real_tracks.md": real_tracks.text,
    "docs/results/confirmation.md": confirmation.text,
    "docs/results/literature.md": literature.text,
    "docs/results/suites.md": suites.text,
    "docs/results/suites_cells.md": suites.cells_text,
    "docs/results/speed.md": speed.text,
    # Tables alone, which pages of docs include.
    "benchmarks/results/learned.md": lambda: table_alone(learned.games()),
    "benchmarks/results/ppo_observer.md": lambda: table_alone(learned.trained()),
    "benchmarks/results/detector_seconds.md": lambda: table_alone(clusters.detectors()),
    "benchmarks/results/engine_costs.md": lambda: table_alone(clusters.engine()),
    "benchmarks/results/multiagent_payoff.md": lambda: table_alone(multiagent.payoff()),
    "benchmarks/results/multiagent_ppo.md": lambda: table_alone(multiagent.trained()),
    "benchmarks/results/multiagent_observers.md": lambda: table_alone(multiagent.observers()),
}
BEGIN, END = "<!-- results:begin -->\n", "<!-- results:end -->"


def readme(old: str) -> str:
    """README.md with its table replaced.

    Raises:
        ValueError: it lacks the markers.
    """
    before, begin, rest = old.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not begin or not end:
        raise ValueError(f"README.md must hold the lines {BEGIN.strip()} and {END}, around its table of results.")
    return f"{before}{BEGIN}\n{index.summary(short=True)}\n\n{END}{after}"


def differing() -> dict[Path, str]:
    """The pages whose text differs from what the rows say, and what they should hold."""
    wanted = {ROOT / name: text() for name, text in PAGES.items()}
    return {
        path: text for path, text in wanted.items() if not path.exists() or path.read_text(encoding="utf-8") != text
    }


def main() -> int:
    parser = make_parser(__doc__)
    parser.add_argument("--check", action="store_true", help="write nothing; exit with 1 if a table differs")
    parser.add_argument("--figures", action="store_true", help="also draw the pictures")
    arguments = parser.parse_args()
    changed, failed = differing(), False
    try:
        path = ROOT / "README.md"
        old = path.read_text(encoding="utf-8")
        if (new := readme(old)) != old:
            changed[path] = new
    except ValueError as error:
        print(error, file=sys.stderr)
        failed = True
    for path, text in changed.items():
        if arguments.check:
            print(f"{path.relative_to(ROOT)} differs from the rows: run python benchmarks/tables.py", file=sys.stderr)
            continue
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_write(path) as aside:
            aside.write_text(text, encoding="utf-8")
    if arguments.figures:
        for path, figure in {tiers.FIGURE: tiers.reliability_figure(), **suites.figures()}.items():
            write_figure(figure, path)
    return int(failed or (arguments.check and bool(changed)))


if __name__ == "__main__":
    sys.exit(main())
