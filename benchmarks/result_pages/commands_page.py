"""benchmarks/README.md: every file of results with the commands that make it."""

from __future__ import annotations

import commands

from result_pages.text import NOTICE


def text() -> str:
    """The page."""
    parts = [
        NOTICE,
        "# Benchmarks",
        "Every committed file of `results/` with the exact commands that make it, row for row. Run them from the root "
        "of the repository, with `OMP_NUM_THREADS=1` where cores are shared with other work. A command goes on from "
        "the rows that are there; to measure anew, give another folder or delete the file. Columns of seconds depend "
        "on the machine. The tables are in `docs/results/`; `python benchmarks/tables.py` writes them from these "
        "files, and `python benchmarks/tables.py --check` finds tables that differ.",
        "**Seeds.** Detectors were tuned on seeds below 1000. Published episodes have the seeds 2022 and above. Not "
        "all of them were new to the detector that plays them: rules of `follow-mixture` were changed after looks at "
        "rows of seed 2022, which `learned.csv`, `ppo_observer.csv` and `multiagent_*.csv` have, and of seed 7077, "
        "which `follow_mixture/` has. The rows of seed 5353 in `former_core/`, and most of seed 4242, were first "
        "played after its last change. No follow strategy of the benchmarks is new to it either.",
        "**Former core.** `former_core/` holds rows of the former core of `follow-mixture`, whose code commit dcdecd2 "
        "has, and rows of the present core on the same swarms. The rows of `follow-mixture` in `learned.csv`, "
        "`ppo_observer.csv`, `multiagent_*.csv` and `follow_mixture_speed.json` are of the former core, too.",
        "Speeds are ratios of contestants that take turns within one run, because the speed of a shared machine "
        "drifts.",
    ]
    for result in commands.RESULTS:
        files = ", ".join(f"`{name}`" for name in result.files)
        parts += [
            f"**{result.what[0].upper()}{result.what[1:]}**: {files}",
            "\n".join(["```shell", *result.commands, "```"]),
        ]
    return "\n\n".join(parts) + "\n"
