"""The ablation of follow-mixture: partial replays give what whole runs give, and the table is what the rows say."""

import csv
import shlex
from collections import Counter
from pathlib import Path

import commands
import follow_mixture_ablation as ablation
import numpy as np
import pytest
from ablation_switches import SWITCHES
from follow_mixture import Cell
from partial_replay import Edit, Replay, Set, Switch, content
from result_pages import ablation as page

import detectors.follow_mixture.facility as facility
import detectors.follow_mixture.search as search

FILE = Path(__file__).parents[2] / "benchmarks" / "results" / page.FILE
# A fit by way 1, a straight swarm, a noisy one, and one in which no UAV follows.
GAMES = (
    Cell("t", "a", {"follow": "f1", "clusters": 2, "uavs": 10, "observation_steps": 25}),
    Cell("t", "b", {"follow": "f2", "clusters": 2, "uavs": 10, "observation_steps": 25, "mobility": "straight"}),
    Cell("t", "c", {"follow": "f3", "clusters": 2, "uavs": 10, "observation_steps": 25, "position_noise": 0.3}),
    Cell("t", "d", {"follow": "none", "clusters": 2, "uavs": 8, "observation_steps": 20}, "silence"),
)


@pytest.fixture
def replay():
    with ablation.make_replay() as made:
        yield made


def signature(played):
    return [fired.tolist() for fired in played.fired]


@pytest.mark.parametrize("cell", GAMES, ids=lambda cell: cell.name)
def test_partial_replays_are_whole_runs_under_a_switch(replay, cell):
    game = ablation.Game(cell, 1)
    replay.forget()
    whole = game.play(replay.run)
    some = [switch.key for switch in SWITCHES if not switch.second][:: 6 if cell.name in "ab" else 9]
    partly = {}
    for key in some:
        partly[key] = signature(game.play(lambda call, key=key: replay.run(call, key), whole))
        if key not in whole.reached:
            assert partly[key] == signature(whole), key
    for key in some:
        replay.forget()  # nothing is stored, so everything is computed under the switch
        assert signature(game.play(lambda call, key=key: replay.run(call, key))) == partly[key], key


def test_wrappers_and_constants_go_away_afterwards():
    plain, value = search.locate_heads, facility.LEAST_VOTERS
    switch = Switch("a", "", "", (Set("facility.LEAST_VOTERS", 1), Edit("facility._drop", "> 1", "> 2")))
    with Replay(ablation.PACKAGE, ablation.MODULES, (switch,), ("facility.locate_heads",)) as made:
        assert search.locate_heads is not plain
        assert made.run(lambda: facility.LEAST_VOTERS, "a").result == 1
        assert value == facility.LEAST_VOTERS
    assert search.locate_heads is plain


def test_only_what_a_switch_reaches_runs_again():
    gain = np.array([[0.0, 9.0, 0.0], [0.0, 0.0, 0.0], [0.0, 8.0, 0.0]])
    switches = (
        Switch("votes", "", "", (Set("facility.LEAST_VOTERS", 3),)),
        Switch("gate", "", "", (Set("gate._MARGIN", 0.0),)),
    )
    with Replay(ablation.PACKAGE, ablation.MODULES, switches, ("facility.locate_heads",)) as made:

        def heads():
            return search.locate_heads(gain, np.arange(3), 1.0)

        whole = made.run(heads)
        assert whole.reached == {"votes"}
        assert whole.result.heads.tolist() == [1]
        assert made.run(heads, "gate").result is whole.result
        other = made.run(heads, "votes")
        assert other.changed
        assert other.result.heads.tolist() == []
        assert made.run(heads).result is whole.result


@pytest.mark.parametrize("change", [Edit("facility._drop", "no such text", ""), Edit("facility.none", "", "")])
def test_a_change_that_does_not_fit_is_refused(change):
    with (
        pytest.raises(ValueError, match=r"facility\."),
        Replay(ablation.PACKAGE, ablation.MODULES, (Switch("a", "", "", (change,)),), ()),
    ):
        pass


def test_content_is_of_values_and_types():
    one = np.arange(6.0)
    assert content([one, None, (1, "a")]) == content([one.copy(), None, (1, "a")])
    different = [one, one.reshape(2, 3), one.astype(np.float32), [0.0, 1.0], None, 0, False, "0", slice(0, 1)]
    assert len({content(value) for value in different}) == len(different)
    with pytest.raises(TypeError, match="Generator"):
        content(np.random.default_rng(0))


def test_paired_change_counts_games_without_a_difference():
    mean, low, high = page.paired_change([1.0] * 30, 300)
    assert mean == pytest.approx(0.1)
    assert 0.05 < low < mean < high < 0.15
    assert page.paired_change([], 10) == (0.0, 0.0, 0.0)
    assert page.paired_change([1.0, 1.0, -1.0], 300)[1] < 0


def rows_of_file():
    with FILE.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_rows_are_those_of_the_commands_and_name_listed_switches():
    rows = rows_of_file()
    known = {switch.key: "second" if switch.second else "first" for switch in SWITCHES}
    assert all(known[row["switch"]] == row["list"] for row in rows if row["switch"])
    wanted: set[tuple[str, ...]] = set()
    for command in commands.commands_of(page.FILE):
        asked = ablation.parser().parse_args(shlex.split(command)[2:])
        which = "second" if asked.second else "first"
        for tier, count in ablation.chosen(asked).items():
            cells = [""] if tier == "random" else [c.name for c in ablation.cells_of(tier, asked.cell)]
            wanted |= {(tier, which, cell, str(number)) for cell in cells for number in range(count)}
    played = [row for row in rows if not row["switch"]]
    names = [(r["tier"], r["list"], "" if r["tier"] == "random" else r["cell"], r["game"]) for r in played]
    assert Counter(names) == Counter(wanted)


def test_rows_of_switches_are_of_games_in_which_they_changed_something():
    rows = rows_of_file()
    whole = {(r["tier"], r["cell"], r["game"], r["list"]): r["changed"].split() for r in rows if not r["switch"]}
    for row in rows:
        if row["switch"]:
            assert row["switch"] in whole[row["tier"], row["cell"], row["game"], row["list"]]
