"""The published rows: they load by name, and a run with their seed meets the same swarms."""

import pytest

import usnet_env
from usnet_env import ArgumentError
from usnet_env.evaluation import evaluate_suite, load_suite


def test_a_run_of_mine_joins_the_published_rows():
    published = usnet_env.results("paper")
    assert set(published.cells) == set(load_suite("paper").cells)
    mine = evaluate_suite("paper", {"mine": "none"}, seed=published.config["seed"], episodes=1)
    difference = published.merge(mine).compare("mine", "none", "J")
    assert (difference.episodes, difference.difference) == (len(published.cells), 0)


def test_a_suite_without_rows_is_refused(tmp_path):
    with pytest.raises(ArgumentError, match=r"^suite must"):
        usnet_env.results("nowhere")
    (tmp_path / "own.yaml").write_text("extends: paper\nversion: 9999\n")
    with pytest.raises(ArgumentError, match=r"^suite must"):
        usnet_env.results(str(tmp_path / "own.yaml"))
