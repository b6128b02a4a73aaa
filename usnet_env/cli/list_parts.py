"""``usnet list``: list the available parts."""

from __future__ import annotations

import inspect

import click

from usnet_env.cli.output import show
from usnet_env.config import ArgumentError, MissingExtraError
from usnet_env.detection import Tags, read_tags
from usnet_env.parts import REGISTRIES, find_entry_points

_REGISTRIES = ("follow", "mobility", "kinematics", "formation", "clusterer", "format")
_STRATEGY_WORDS = {  # what a follow strategy is
    "f1": "copies the last velocity of its head",
    "f2": "copies the sum of the last two velocities of its head",
    "f3": "copies the sum of the last three velocities of its head",
    "f4": "copies the squares, axis by axis, of the last two velocities of its head",
    "f5": "copies the squares, axis by axis, of the last three velocities of its head",
    "f6": "copies the last velocity of its head, and is pulled to it beyond 60 m",
    "f7": "a random network of its own positions and of the head's velocities and position",
    "random": "a random law of the head's last velocities, another one in each episode, and none of f1 to f7",
    "unequal_delays": "followers copy their head, each with its own delay, gain and noise",
    "mixed": "each follower has one of f1 to f6",
    "switching": "followers have f1 to f6 in turn within a window",
    "chain": "followers copy followers, in a tree below the head",
    "pigeons": "followers copy up to three UAVs above them in a hierarchy, each after a delay",
    "cucker_smale": "followers align with UAVs above them in a hierarchy, less with far ones",
    "vicsek": "followers fly as the UAVs near them do on average, the head among them",
    "couzin": "a flock with zones of repulsion, alignment and attraction around each follower",
    "informed": "a couzin flock in which the heads fly along and also prefer a course",
    "frontness": "a formation whose head is in front, in the middle or behind",
    "part_time": "followers copy their head, which leads only part of the time",
    "partial_turns": "followers copy their head, each only part of the time",
    "predator": "a couzin flock with a head, chased by a predator",
    "shepherd": "a flock that flees a driver behind it; no UAV leads",
    "reference": "a formation around a moving point that no UAV flies; no UAV leads",
    "independent": "every UAV flies on its own; no UAV leads",
    "shifted": "followers of f2, each seen from another time on; no UAV leads",
    "weak": "followers copy their head weakly",
    "late": "followers copy their head after 10 steps or more",
}
_GRAMMARS = {
    "open": "laws composed of parts, with constants drawn at random: how the head is heard, and what is copied",
    "second": "laws of another grammar, likewise: how the head is seen, what is answered, and when",
}
_RECOMMENDED, _MAX_COMPARED = "reader", 10_000  # the limit of detectors that compare UAVs
_NAMES = ("envs", "detectors", *_REGISTRIES, "suites")


@click.command(name="list", short_help="List envs, detectors, follow strategies and other parts.")
@click.argument("part", metavar="[PART]", type=click.Choice(_NAMES), required=False)
def list_(part: str | None) -> None:
    """List the available parts of a kind, with one line about each; without a word, what can be listed."""
    from rich.table import Table
    from rich.text import Text

    table = Table.grid(padding=(0, 2))
    table.add_column(no_wrap=True)
    rows = {f"usnet list {name}": "" for name in _NAMES} if part is None else _describe_parts(part)
    for name, description in rows.items():
        table.add_row(Text(name), Text(description))
    show(table)
    if part == "detectors":
        show(f"Start with {_RECOMMENDED}. Detectors that compare UAVs take at most {_MAX_COMPARED:,}.")


def _describe_parts(part: str) -> dict[str, str]:
    """A description of one line for each part of this type."""
    if part == "suites":
        from usnet_env.evaluation import list_suites

        suites = list_suites().values()
        return {suite.name: f"{suite.purpose} ({len(suite.cells)} cells, version {suite.version})" for suite in suites}
    if part == "envs":
        from usnet_env.evaluation.environments import describe_environments

        return dict(describe_environments())
    rows = _describe_registry("detector" if part == "detectors" else part)
    if part != "follow":
        return rows
    for grammar, text in _GRAMMARS.items():  # many laws on one line
        laws = [name for name in rows if name.startswith(f"{grammar}-")]
        rows = {name: line for name, line in rows.items() if name not in laws}
        rows[f"{laws[0]} to {laws[-1]}"] = text
    return rows | {"none": "no UAV follows: followers fly like heads (a control)"}


def _describe_registry(argument: str) -> dict[str, str]:
    """In words, by equation or by docstring, all parts that an argument selects, and the tags of detectors."""
    import usnet_env.plugins
    import usnet_env.swarm
    import usnet_env.tracks.readers  # noqa: F401  # they create registries

    if argument in (modules := find_entry_points("usnet.registries")):
        modules[argument].load()
    (registry,) = [registry for registry in REGISTRIES.values() if registry.argument == argument]
    rows, words = {}, _STRATEGY_WORDS if argument == "follow" else {}
    for name in sorted(registry, key=lambda name: (name != _RECOMMENDED, name)) if argument == "detector" else registry:
        try:
            part = registry[name]
            texts = words.get(name.removesuffix("-led")), getattr(part, "description", "")
            equation = getattr(part, "equation", "") if argument == "follow" else ""  # not its base class
            text = next(filter(None, (*texts, equation)), inspect.getdoc(part) or "")
            line = text.partition("\n")[0] + "; its heads follow unseen UAVs" * name.endswith("-led")
            mark = " (recommended)" * (argument == "detector" and name == _RECOMMENDED)
            rows[name] = f"{line}{mark} {_format_tags(read_tags(part))}".rstrip()
        except (ArgumentError, MissingExtraError) as error:
            rows[name] = f"not available: {error}"
    return rows


def _format_tags(tags: Tags) -> str:
    """The tags that differ from those of a detector that takes every window, in brackets."""
    texts = {
        f"needs {', '.join(tags.needs)}": bool(tags.needs),
        f"at most {tags.most_uavs} UAVs": tags.most_uavs not in (None, _MAX_COMPARED),
        f"at least {tags.least_steps} steps": tags.least_steps > 1,
        "made for 1 m per step": tags.needs_unit_speed,
        "velocities only": not tags.uses_positions,
        "takes M": tags.takes_clusters,
        "in tracks only --unconfirmed": tags.false_leaders,
    }
    listed = "; ".join(text for text, applies in texts.items() if applies)
    return f"({listed})" if listed else ""
