"""Every committed file of results has its commands, and their arguments are what the file records of itself."""

import json
import shlex
from collections import Counter
from collections.abc import Callable, Iterable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import follow_mixture
import gaps
import learned
import multiagent_observers
import multiagent_payoff
import pytest
from result_pages import cores, text
from running import SEED, read_csv

from detectors.studies import rounds as rounds_study
from detectors.studies import table2
from detectors.studies.commands import reproduce

ROOT = Path(__file__).parents[2]
RESULTS = ROOT / "benchmarks" / "results"
Key = tuple[Any, ...]


def keys_of(path: Path, columns: Iterable[str]) -> Counter[Key]:
    """How often each combination of the columns occurs in a file."""
    return Counter(tuple(row[column] for column in columns) for row in read_csv(path))


def words_of(name: str, program: str) -> list[list[str]]:
    """The arguments of the commands of a file; every one of them must run the program."""
    made = [shlex.split(command, comments=True) for command in text.commands_of(name)]
    start = shlex.split(program)
    assert made
    assert all(words[: len(start)] == start for words in made)
    return [words[len(start) :] for words in made]


def test_every_committed_file_has_commands() -> None:
    files = {str(path.relative_to(RESULTS)) for path in RESULTS.rglob("*") if path.is_file()}
    listed = [name for names in text.COMMANDS for name in names]
    assert len(set(listed)) == len(listed)
    folders = tuple(name for name in listed if name.endswith("/"))
    assert {name for name in files if not name.startswith(folders)} == {name for name in listed if name not in folders}
    assert all((RESULTS / name).is_dir() for name in folders)
    assert all(text.COMMANDS.values())


@pytest.mark.parametrize("tier", sorted({cell.tier for cell in follow_mixture.cells()}))
def test_commands_of_a_tier_make_its_rows(tier: str) -> None:
    wanted: set[Key] = set()
    for words in words_of(f"follow_mixture/{tier}.csv", "python benchmarks/follow_mixture.py"):
        arguments = follow_mixture.parser().parse_args(words)
        assert arguments.tier == [tier]
        labels = [follow_mixture.label_of(name) for name in arguments.detectors]
        for cell in follow_mixture.chosen(arguments):
            for label in labels:
                for episode in range(arguments.episodes):
                    wanted.add((tier, cell.name, label, str(arguments.seed), str(episode)))
    columns = ("tier", "cell", "detector", "seed", "episode")
    assert keys_of(RESULTS / "follow_mixture" / f"{tier}.csv", columns) == Counter(wanted)


@pytest.mark.parametrize("name", cores.FILES)
def test_commands_of_a_core_make_its_rows(name: str) -> None:
    made = [shlex.split(command, comments=True) for command in text.commands_of(name)]
    played = [words[2:] for words in made if words[0] == "python"]
    assert all(words[:2] == ["python", "benchmarks/follow_mixture.py"] for words in made if words[0] != "git")
    *steps, packing = (follow_mixture.parser().parse_args(words) for words in played)
    assert packing.pack == Path("benchmarks/results", name)
    assert all(step.results == packing.results and step.pack is None for step in steps)
    wanted = {
        (cell.tier, cell.name, label, str(step.seed), str(episode))
        for step in steps
        for label in map(follow_mixture.label_of, step.detectors)
        for cell in follow_mixture.chosen(step)
        for episode in range(step.episodes)
    }
    assert keys_of(RESULTS / name, ("tier", "cell", "detector", "seed", "episode")) == Counter(wanted)


@pytest.mark.parametrize("name", ["learned.csv", "learned_limits.csv"])
def test_commands_of_learned_make_its_rows(name: str) -> None:
    wanted: set[Key] = set()
    columns = ("tier", "cell", "detector") if "limits" in name else ("swarm", "follow", "detector")
    for words in words_of(name, "python benchmarks/learned.py"):
        arguments = learned.parser().parse_args(words)
        assert arguments.limits == ("limits" in name)
        for cell in learned.chosen(arguments):
            place = tuple(cell[column] for column in columns)
            wanted |= {(*place, str(seed)) for seed in range(SEED, SEED + arguments.games)}
    assert keys_of(RESULTS / name, (*columns, "seed")) == Counter(wanted)


@pytest.mark.parametrize(
    ("name", "module", "columns"),
    [
        ("multiagent_payoff.csv", multiagent_payoff, ("follow", "observer", "swarm")),
        ("multiagent_observers.csv", multiagent_observers, ("detector", "range", "observers", "fusion")),
        ("gaps.csv", gaps, ("detector", "rule", "miss_rate")),
    ],
)
def test_scripts_without_arguments_make_their_rows(name: str, module: Any, columns: tuple[str, ...]) -> None:
    assert words_of(name, f"python benchmarks/{Path(name).stem}.py") == [[]]
    wanted = Counter((*(str(cell[column]) for column in columns), str(seed)) for cell, seed in module.games())
    assert keys_of(RESULTS / name, (*columns, "seed")) == wanted


def test_commands_of_multi_cluster_match_the_recorded_configuration() -> None:
    (command,) = text.commands_of("multi_cluster/")
    script = (ROOT / command).read_text(encoding="utf-8").replace("\\\n", " ")
    loop, line = (next(row for row in script.splitlines() if part in row) for part in ("for follow in", " evaluate "))
    follows = loop.partition(" in ")[2].rstrip("; do").split()
    words = shlex.split(line)
    asked = {word: words[place + 1] for place, word in enumerate(words[:-1]) if word.startswith("--")}
    detectors = [words[place + 1] for place, word in enumerate(words) if word == "--detector"]
    for follow in follows:
        config = json.loads((RESULTS / "multi_cluster" / follow / "run.json").read_text(encoding="utf-8"))["config"]
        assert config["env"] == asked["--env"]
        assert config["env_kwargs"] == {"follow": follow}
        assert (config["episodes"], config["seed"]) == (int(asked["--episodes"]), int(asked["--seed"]))
        assert "--trivial" in words
        assert config["detectors"][: len(detectors)] == detectors
        rows = keys_of(RESULTS / "multi_cluster" / follow / "episodes.csv", ("detector", "episode"))
        episodes = range(config["episodes"])
        assert rows == Counter((name, str(episode)) for name in config["detectors"] for episode in episodes)
    assert sorted(path.name for path in (RESULTS / "multi_cluster").iterdir()) == follows


def parameters(words: list[str], command: str) -> dict[str, Any]:
    """What `usnet reproduce` makes of the words."""
    found: dict[str, Any] = reproduce.commands[command].make_context(command, list(words)).params
    return found


def table2_keys(asked: dict[str, Any]) -> set[Key]:
    """Detector, cell and episode of every row that a command asks for."""
    names = asked["detectors"] or table2.DETECTORS
    flight = (str(asked["decoys"]), asked["mobility"], str(asked["head_jitter"]))
    return {
        (name, follow, str(followers), *flight, str(episode))
        for name in names
        for follow, followers in table2.parse_cells(asked["cells"])
        for episode in range(asked["episodes"] or (100 if followers <= 15 else 30))
    }


def rounds_keys(asked: dict[str, Any]) -> set[Key]:
    """The same of `usnet reproduce rounds`."""
    names = [*(asked["detectors"] or rounds_study.DETECTORS), *(() if asked["no_trivial"] else rounds_study.TRIVIAL)]
    studies = asked["studies"] or rounds_study.STUDIES
    cells = rounds_study.list_cells(studies, names, asked["mobility"], asked["head_jitter"])
    return {(*map(str, vars(cell).values()), str(episode)) for cell in cells for episode in range(asked["episodes"])}


REPRODUCED = [
    (path.relative_to(RESULTS), command)
    for folder, command in (("table2", "table2"), ("rounds", "rounds"))
    for path in sorted((RESULTS / folder).glob("*.csv"))
]


@pytest.mark.parametrize(("file", "command"), REPRODUCED, ids=[str(file) for file, _ in REPRODUCED])
def test_commands_of_reproductions_make_their_rows(file: Path, command: str) -> None:
    keys: dict[str, tuple[Callable[[dict[str, Any]], set[Key]], tuple[str, ...]]] = {
        "table2": (
            table2_keys,
            ("detector", "follow", "followers", "decoys", "mobility", "head_jitter", "episode"),
        ),
        "rounds": (
            rounds_keys,
            ("detector", "follow", "clusters", "uavs", "mobility", "head_jitter", "episode"),
        ),
    }
    made, columns = keys[command]
    wanted: set[Key] = set()
    for words in words_of(file.as_posix(), f"usnet reproduce {command}"):
        asked = parameters(words, command)
        assert asked["out"] == f"benchmarks/results/{file.parent}"
        assert file.stem.endswith(f"-seed{asked['seed']}")
        wanted |= made(asked)
    assert keys_of(RESULTS / file, columns) == Counter(wanted)


@pytest.mark.skipif(find_spec("stable_baselines3") is None, reason="needs the extra rl")
def test_command_of_the_ppo_observer_makes_its_rows() -> None:
    import ppo_observer

    assert words_of("ppo_observer.csv", "python benchmarks/ppo_observer.py") == [[]]
    wanted = Counter(
        (swarm, follow, detector, str(episode))
        for swarm in ppo_observer.SWARMS
        for follow in ppo_observer.FOLLOW
        for detector in ("ppo", *ppo_observer.DETECTORS)
        for episode in range(ppo_observer.GAMES)
    )
    assert keys_of(RESULTS / "ppo_observer.csv", ("swarm", "follow", "detector", "episode")) == wanted
