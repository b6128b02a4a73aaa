"""The figures of P2: rows that the referee would give, the paper's words beside them, nothing lost or repeated."""

from dataclasses import asdict, replace

import numpy as np
import pytest

import usnet_env
from detectors.studies import rounds
from detectors.studies.rounds import STUDIES, Cell, Row, list_cells, play_games, reproduce
from usnet_env import ArgumentError
from usnet_env.evaluation import TRIVIAL
from usnet_env.evaluation.suite import read_rows, split_games

QUICK = "lagged-correlation"
SMALL = ("f1", 2, 14)


@pytest.fixture
def small_studies(monkeypatch):
    """Studies of small swarms, in which everything is as in large ones but quick."""
    small = {"follow": (("f1", 2, 14), ("f4", 2, 14)), "example": (("f1", 3, 20),)}
    monkeypatch.setattr(rounds, "STUDIES", small)
    return small


def plain(rows):
    """Rows without seconds and with NaN as a number that equals itself."""
    kept = [{**asdict(row), "seconds_per_round": 0} for row in rows]
    return [{name: -1 if value != value else value for name, value in row.items()} for row in kept]


def row(episode=0, named="8 2", hits="6 2", detector="x", follow="f1", **more):
    numbers = {name: 1.0 for name, kind in Row.__annotations__.items() if kind in ("float", "int")}
    return Row(
        **numbers | {"clusters": 8, "uavs": 185} | more | {"episode": episode},
        detector=detector,
        follow=follow,
        mobility="iid",
        head_jitter=False,
        named=named,
        hits=hits,
    )


def test_the_studies_are_the_paper_s():
    cells = list_cells(tuple(STUDIES), [QUICK])
    assert len(cells) == 7 + 5 + 6 + 1 - 2  # f1 M=5 and f3 N=82 stand in two studies
    assert {cell.clusters for cell in list_cells(["clusters"], [QUICK])} == {2, 3, 5, 8, 10}
    assert list_cells(["example"], ["none"], "gauss_markov", True) == [Cell("none", "f1", 8, 185, "gauss_markov", True)]
    with pytest.raises(ArgumentError, match="study"):
        list_cells(["size"], [QUICK])


def test_all_cells_have_their_first_episodes_before_any_has_its_last():
    tasks = split_games(list_cells(["clusters"], ["a", "b"]), 5, 2)
    first = [games[0][1] for games in tasks]
    assert first == sorted(first)
    assert sum(map(len, tasks)) == 2 * 5 * 5


def test_rows_are_those_of_the_referee():
    rows = play_games([(Cell(QUICK, *SMALL), episode) for episode in range(6)], 7)
    referee = usnet_env.evaluate(
        "USNET/MultiCluster-v0", QUICK, episodes=6, seed=7, env_kwargs={"clusters": 2, "uavs": 14}
    )
    for ours, theirs in zip(rows, referee.rows, strict=True):
        for name in ("J", "rounds", "redundancy", "success", "exact", "ap_first", "purity_first"):
            assert getattr(ours, name) == pytest.approx(theirs[name]), name


@pytest.mark.parametrize("detector", ["random(count=3)", "one-per-round", QUICK])
def test_rounds_add_up(detector):
    for made in play_games([(Cell(detector, "f5", 3, 20), episode) for episode in range(4)], 11):
        named, hits = np.array(made.list_rounds()).T
        assert len(named) == made.rounds
        assert (hits <= named).all()
        assert hits.sum() <= 3
        assert (hits.sum() == 3) == bool(made.success)
        assert named.sum() - hits.sum() == made.redundant
        assert pytest.approx(len(named) + made.redundant / 20) == made.J


def test_destroying_all_uavs_costs_what_it_must():
    (made,) = play_games([(Cell("destroy-all", *SMALL), 0)], 3)
    assert made.list_rounds() == [(14, 2)]
    assert pytest.approx(1 + 12 / 14) == made.J
    assert np.isnan(made.purity_first)


def test_by_default_the_paper_s_algorithm_is_measured_beside_two_other_detectors(asked, tmp_path):
    with pytest.raises(KeyboardInterrupt):
        reproduce(tmp_path)
    detectors = [*dict.fromkeys(cell.detector for cell, _ in asked)]
    assert detectors == ["mc-gassl", "lead-votes", "lagged-regression", *TRIVIAL]


def test_the_paper_s_words():
    words = rounds.read_paper()
    assert list(words) == list(STUDIES)
    assert words["follow"].bounds("J", 82) == pytest.approx((3.06, 4.06), abs=0.005)
    assert words["clusters"].bounds("redundancy", 82)[1] == pytest.approx(0.222, abs=0.0005)
    assert words["example"].bounds("redundancy", 185)[0] == pytest.approx(0.0108, abs=0.00005)
    assert words["clusters"].at_most
    assert not words["uavs"].at_most


def test_every_episode_counts_in_every_round():
    table = rounds.find_by_round([row(0), row(1, "8", "8")], 3)
    assert table == [([8, 8], [6, 8]), ([2, 0], [8, 8]), ([0, 0], [8, 8])]


def test_means_are_over_all_episodes():
    made = [row(0, rounds=1, success=1), row(1, rounds=20, success=0)]
    assert rounds.measure_field(made, "rounds").mean == 10.5
    assert rounds.measure_field(made, "success").mean == 0.5
    assert rounds.measure_field(made[:1], "success").high == 1.0
    assert rounds.measure_field([replace(made[0], purity_first=np.nan)], "purity_first") is None


def test_a_measurement_goes_on_and_makes_table_and_picture(tmp_path, small_studies, monkeypatch):
    path = tmp_path / "rounds-seed5.csv"
    arguments = {"studies": list(small_studies), "detectors": [QUICK], "seed": 5}
    first = reproduce(tmp_path, episodes=2, **arguments).rows
    assert len(first) == 3 * 5 * 2
    played, seen = [], []
    monkeypatch.setattr(rounds, "play_games", lambda games, **seeds: played.extend(games) or play_games(games, **seeds))
    both = reproduce(tmp_path, episodes=3, progress=lambda *count: seen.append(count), **arguments).rows
    assert {episode for _, episode in played} == {2}
    assert seen[0] == (30, 45)
    assert seen[-1] == (45, 45)
    assert len(read_rows(path, Row)) == len(both) == 45
    table = path.with_suffix(".md").read_text(encoding="utf-8")
    assert f"| f4 | {QUICK} | 3 |" in table
    assert f"| all | {QUICK} | 6 |" in table
    assert "| f1 | the paper, in words | | 3–4 | 5 |" in table
    assert "| the paper | 8 / 75 | 2 / 100 |" in table
    assert all(f"| {name} |" in table for name in TRIVIAL)
    assert path.with_suffix(".png").read_bytes().startswith(b"\x89PNG")


def test_other_heads_have_a_file_of_their_own_without_the_paper(tmp_path, small_studies):
    reproduce(
        tmp_path, studies=["follow"], detectors=["one-per-round"], trivial=False, episodes=1, mobility="gauss_markov",
        head_jitter=True,
    )  # fmt: skip
    table = (tmp_path / "rounds-gauss_markov-jitter-seed2022.md").read_text(encoding="utf-8")
    assert "gauss_markov heads with jitter" in table
    assert "the paper" not in table.lower()


def test_rows_are_the_same_on_two_processes(tmp_path, small_studies):
    arguments = {"studies": ["follow"], "detectors": ["random"], "trivial": False, "episodes": 4, "seed": 1}
    one, two = (reproduce(tmp_path / str(workers), workers=workers, **arguments).rows for workers in (1, 2))
    assert plain(one) == plain(two)


def test_isolated_detectors_have_the_same_rows():
    games = [(Cell(QUICK, *SMALL), episode) for episode in range(2)]
    assert plain(play_games(games, 5, isolate=True)) == plain(play_games(games, 5))


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"studies": ["sizes"]}, "study"),
        ({"detectors": ["mc-gasl"]}, "did you mean 'mc-gassl'"),
        ({"detectors": ["mc-gassl(preset='paper')"]}, "has no argument 'preset'"),
        ({"detectors": ["mc-gassl(gassl={'steps': 0})"]}, "steps"),
        ({"mobility": "iids"}, "mobility"),
        ({"episodes": 0}, "episodes"),
        ({"detectors": [], "trivial": False}, "detectors"),
    ],
)
def test_bad_arguments_leave_nothing_behind(tmp_path, arguments, said):
    with pytest.raises(ArgumentError, match=said):
        reproduce(tmp_path, **{"detectors": ["random"], "episodes": 1} | arguments)
    assert not list(tmp_path.iterdir())


def test_the_picture_has_a_row_of_panels_a_study(small_studies):
    made = [row(number, detector=name, clusters=3, uavs=20) for number in range(2) for name in (QUICK, "none")]
    figure = rounds.draw_studies(made, "title", with_paper=True)
    assert len(figure.axes) == 3
    assert figure.axes[0].get_ylabel() == "heads found, %"


def test_a_study_with_one_swarm_of_several_is_left_out_of_the_picture():
    cells = [("f1", 5, 82), ("f2", 5, 82)]  # f1 is also a swarm of the sweep over M
    made = [row(0, detector=QUICK, follow=follow, clusters=m, uavs=n) for follow, m, n in cells]
    first, *others = rounds.draw_studies(made, "title", with_paper=False).axes
    assert len(others) == 2
    assert [tick.get_text() for tick in first.get_xticklabels()] == ["f1", "f2"]
