"""Controls of suites, in cells of a file: what tells heads to a rule that sees no pair of UAVs."""

import leaks
import pytest
from paper.shared import read_rows
from tables import suite_file

from usnet_env.evaluation import list_suites

SUITE = """
version: 1
purpose: A cell whose heads turn at random, and one whose heads, decoys and followers fly alike.
episodes: 1
seed: 1000
tuning_seed: 1
arguments: {clusters: 2, decoys: 1, uavs: 11, observation_steps: 40}
cells:
  told: {follow: f4, formation: around}
  hidden: {follow: f1, mobility: gauss_markov, head_jitter: true, formation: gathered, position_noise: 0.3}
  unled: {follow: reference, memory: 12}
"""


@pytest.fixture
def suite(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text(SUITE, encoding="utf-8")
    return path


@pytest.mark.slow
def test_controls_tell_heads_where_something_gives_them_away(suite, tmp_path, capsys):
    words = ["--suite", str(suite), "--rows", str(tmp_path / "rows.csv")]
    leaks.main([*words, "--cell", "told", "--cell", "hidden", "--swarms", "24"])
    rows = read_rows(tmp_path / "rows.csv")
    found = rows.groupby("cell").mean(numeric_only=True)
    assert (rows.groupby("cell").size() == 24).all()
    assert found.auc_without_decoys["told"] > found.auc_track["told"] > 0.8  # decoys turn like heads
    assert found.auc_first["told"] > 0.7  # in the middle
    assert found.loc["hidden", leaks.AUCS].between(0.35, 0.65).all()
    assert found.all_track["told"] > found.all_track["hidden"]
    assert (found.strange_heads["hidden"], found.strange_followers["hidden"]) == (0, 0)
    assert "| 2 | 1 |" in capsys.readouterr().out
    leaks.main([*words, "--cell", "told", "--cell", "unled", "--swarms", "3"])  # the first is there already
    again = read_rows(tmp_path / "rows.csv")
    assert again.groupby("cell").size().to_dict() == {"told": 24, "hidden": 24, "unled": 3}
    assert again[again.heads == 0][[*leaks.AUCS, "strange_heads"]].isna().all().all()


def test_strange_tracks_are_of_other_clusters_and_keep_their_roles(suite):
    env = leaks.shared.open_cell(str(suite), "hidden")
    for swarms, different in ((11, 11), (6, 6)):  # from a swarm at most one track, or from a cluster
        flown = leaks.fly(env, 1, swarms)
        window, role = leaks.meet_strangers(flown, 2)
        where = {
            window.position[:, i].tobytes(): (s, k)
            for s, (window, cluster) in enumerate(zip(flown.windows, flown.cluster, strict=True))
            for i, k in enumerate(cluster)
        }
        origins = [where[window.position[:, i].tobytes()] for i in range(window.uavs)]
        assert len(set(origins)) == window.uavs == 11
        assert len({swarm for swarm, _ in origins}) == different
        assert sorted(role) == sorted(flown.role[2])


def test_every_cell_of_every_suite_with_rows_has_controls():
    rows = read_rows(leaks.ROWS)
    known = set(rows[["suite", "version", "cell"]].itertuples(index=False, name=None))
    played = [suite for name, suite in list_suites().items() if suite_file(name).exists()]
    assert known == {(suite.name, suite.version, cell) for suite in played for cell in suite.cells}
    assert (rows.groupby(["suite", "cell"]).size() >= 24).all()
    hard = rows[rows.suite == "paper-hard"].groupby("cell").auc_track.mean()
    assert hard.max() < 0.6
