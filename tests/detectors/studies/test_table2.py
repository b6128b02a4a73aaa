"""The table of detection rates beside the paper's."""

import numpy as np
import pytest

from detectors.studies import common, table2
from usnet_env import ArgumentError, make_detector
from usnet_env.cli import main
from usnet_env.evaluation.statistics import Interval


def test_the_paper_s_table_is_whole():
    rates = table2.read_paper()
    means = [100 * rate.mean for rate in rates.values()]
    assert len(rates) == 70
    assert np.mean(means) == pytest.approx(98.86, abs=0.005)
    assert min(means) == pytest.approx(91.4)
    assert all(rate.low <= rate.mean <= rate.high for rate in rates.values())


@pytest.mark.parametrize(
    ("ours", "expected"),
    [((0.98, 0.97, 0.99), False), ((0.9, 0.85, 0.92), True), ((1.0, 0.995, 1.0), False)],
)
def test_a_rate_is_below_if_its_interval_is(ours, expected):
    entry = table2.Entry("gassl", "f1", 2, 100, Interval(*ours), Interval(0.981, 0.97, 0.988))
    assert entry.is_below == expected


def test_cells_are_cells_or_rows():
    assert len(table2.parse_cells(None)) == 70
    assert table2.parse_cells("f1:2, f4:15") == [("f1", 2), ("f4", 15)]
    assert len(table2.parse_cells("f3,f3:2")) == 10
    for wrong in ("f8", "f1:4", "", "f1:2:3", "2"):
        with pytest.raises(ArgumentError, match="--cells must list cells"):
            table2.parse_cells(wrong)


def test_the_command_makes_rows_a_table_and_a_picture(tmp_path, capsys):
    words = ["reproduce", "table2", "--out", str(tmp_path), "--cells", "f1:2", "--episodes", "4", "--workers", "1"]
    assert main([*words, "--detector", "lagged-regression(clusters=1)"]) == 0
    shown = capsys.readouterr().out
    assert "98.1" in shown  # the paper's
    assert "100.0 (51.0–100.0; 4)" in shown  # ours, with Wilson's interval and n
    assert {path.suffix for path in tmp_path.iterdir()} == {".csv", ".md", ".png"}
    assert (tmp_path / "episodes-seed2022.png").read_bytes().startswith(b"\x89PNG")
    assert main([*words, "--detector", "lagged-regression(clusters=1)", "--decoys", "1"]) == 0
    assert "paper's table" not in (tmp_path / "episodes-decoys1-seed2022.md").read_text(encoding="utf-8")
    assert main([*words, "--detector", "lagged-regression(clusters=1)", "--format", "pdf"]) == 0
    assert (tmp_path / "episodes-seed2022.pdf").read_bytes().startswith(b"%PDF")


def test_the_picture_has_a_panel_a_strategy_or_one_for_a_single_detector():
    some = Interval(0.9, 0.8, 1.0)
    table = [
        table2.Entry(name, follow, size, 10 + size, some, some)
        for name in ("a", "b")
        for follow in ("f1", "f2")
        for size in (2, 5)
    ]
    figure = table2.draw_rates(table, "title", with_paper=False)
    assert [axes.get_title() for axes in figure.axes] == ["f1", "f2"]
    assert len({bars[0].get_marker() for bars in figure.axes[0].containers}) == 2
    assert "n = 12 to 15 episodes a point. Bars are 95 % Wilson intervals." in figure.get_suptitle().replace("\n", " ")
    (axes,) = table2.draw_rates(table[:4], "title", with_paper=False).axes
    assert [bars.get_label() for bars in axes.containers] == ["f1", "f2"]
    assert [tick.get_text() for tick in axes.get_xticklabels()] == ["2", "5"]


@pytest.mark.parametrize(
    ("words", "name"),
    [
        (["--cells", "f9"], "--cells"),
        (["--detector", "gasl"], "did you mean 'gassl'?"),
        (["--detector", "gassl(preset='paper')"], "has no argument 'preset'"),
        (["--detector", "random", "--detector", "gassl(steps=0)"], "steps"),
        (["--preset", "paper"], "--preset"),
        (["--episodes", "0"], "--episodes"),
        (["--mobility", "iids"], "mobility"),
        (["--mobility", "/../../../iids"], "mobility"),
        (["--decoys", "-1"], "--decoys"),
    ],
)
def test_bad_words_are_one_sentence(tmp_path, capsys, words, name):
    assert (
        main(["reproduce", "table2", "--out", str(tmp_path / "out"), "--workers", "1", "--episodes", "2", *words]) == 2
    )
    said = capsys.readouterr().err
    assert name in said
    assert "Traceback" not in said
    assert list(tmp_path.iterdir()) == []


def test_a_second_measurement_joins_the_first_in_the_table(tmp_path, capsys):
    words = [
        "reproduce",
        "table2",
        "--out",
        str(tmp_path),
        "--workers",
        "1",
        "--detector",
        "lagged-regression(clusters=1)",
    ]
    for cell in ("f1:2", "f2:3"):
        assert main([*words, "--cells", cell, "--episodes", "2"]) == 0
    table = (tmp_path / "episodes-seed2022.md").read_text(encoding="utf-8")
    assert "| f1 | lagged-regression(clusters=1) | 100.0" in table
    assert "| f2 | lagged-regression(clusters=1) |  | 100.0" in table
    capsys.readouterr()


def test_each_detector_has_its_own_row_on_the_same_episodes(tmp_path):
    detectors = ["lagged-regression(clusters=1)", "destroy-all"]
    made = table2.reproduce(tmp_path, episodes=3, cells="f1:2,f1:3", detectors=detectors)
    assert {(row.detector, row.followers, row.episode) for row in made.rows} == {
        (detector, followers, episode) for detector in detectors for followers in (2, 3) for episode in range(3)
    }
    table = (tmp_path / "episodes-seed2022.md").read_text(encoding="utf-8")
    assert table == made.text
    assert "| f1 | lagged-regression(clusters=1) | 100.0 (43.9–100.0; 3) | 100.0 (43.9–100.0; 3) |" in table
    assert "| f1 | destroy-all | 0.0 (0.0–56.1; 3) **below** | 0.0 (0.0–56.1; 3) **below** |" in table


def test_by_default_the_paper_s_algorithm_is_measured_beside_two_other_detectors(asked, tmp_path):
    with pytest.raises(KeyboardInterrupt):
        table2.reproduce(tmp_path)
    detectors = {cell.detector for cell, _ in asked}
    assert detectors == {"gassl", "neural-granger", "lagged-regression(clusters=1)"}
    assert len(asked) == 3 * 7 * (5 * 100 + 5 * 30)
    assert all(map(make_detector, detectors))


def test_fast_is_a_quick_look(tmp_path, monkeypatch, capsys):
    asked = []
    monkeypatch.setattr(
        table2, "reproduce", lambda out, **options: asked.append(options) or common.Reproduction([], "")
    )
    words = ["reproduce", "table2", "--out", str(tmp_path), "--fast"]
    assert main(words) == 0
    assert main([*words, "--episodes", "3", "--cells", "f1:2"]) == 0
    fast, chosen = asked
    assert (fast["episodes"], fast["cells"].count(":")) == (10, 7 * 5)
    assert (chosen["episodes"], chosen["cells"]) == (3, "f1:2")
    capsys.readouterr()
