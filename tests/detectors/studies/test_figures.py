"""The figures of the paper: one command makes all of them, and the same call gives the same bytes."""

import csv
import sys

import numpy as np
import pytest

from detectors.gassl import Gassl
from detectors.mc_gassl import McGassl
from detectors.studies import example, figures, metric_learning, purity
from detectors.studies.figures import FIGURES, Settings, make_figures
from usnet_env import ArgumentError, make_detector
from usnet_env.cli import main
from usnet_env.drawing import MissingExtraError, new_figure, write_figure
from usnet_env.evaluation.store import RowFile
from usnet_env.evaluation.table import columns_of

NAMES = {
    "detection-rates",
    "attention-heads-f1-m15",
    "hierarchy-f1-m15",
    "meta-loss",
    "purity",
    "feature-space",
    "rounds",
    "example-m8-n185",
    "attention-sizes-f7",
}


def write_losses(folder):
    rows = [
        metric_learning.Row(training, start, follow, step=step, loss=0.5 / (step + 1) + 0.1 * training)
        for training in range(2)
        for start in metric_learning.STARTS
        for follow in ("", "f1")
        for step in range(3)
        if (start, follow) != ("random", "")
    ]
    path = folder / "metric_learning" / "losses-F30-E1000-seed5.csv"
    with RowFile(path, columns_of(metric_learning.Row), digits=4) as file:
        file.append(map(vars, rows))


def purity_rows(**values):
    methods = [purity.Method("kmeans", features, "given") for features in ("raw", "scaled", "gru-single")]
    return [
        purity.Row(
            **vars(method), follow=follow, episode=episode,
            **{"found": 5, "purity": 0.5, "head_in_cluster": 0.25, "seconds": 0.1} | values,
        )
        for method in methods
        for follow in ("f1", "f2")
        for episode in range(3)
    ]  # fmt: skip


def test_every_figure_of_the_paper_has_a_name():
    assert set(FIGURES) == NAMES


def test_the_detectors_are_the_paper_s_algorithms_with_their_defaults():
    settings = Settings()
    assert type(make_detector(settings.detector_p1)) is Gassl
    assert type(make_detector(settings.detector_p2)) is McGassl
    assert (settings.detector_p1, settings.detector_p2) == ("gassl", "mc-gassl")


def test_the_example_shows_the_attention_of_mc_gassl():
    record = example.play_example("mc-gassl(gassl={'steps': 1}, count=2)", 7, clusters=2, uavs=12)
    assert record.attention.shape == (record.rounds, 12, 12)
    living = record.alive[0]
    np.testing.assert_allclose(record.attention[0][living].sum(axis=1), 1.0, atol=1e-3)


def test_the_command_and_the_function_write_the_same_figure_as_png_and_pdf(tmp_path, capsys):
    write_losses(tmp_path)
    made = make_figures(tmp_path / "a", only=["meta-loss"], settings=Settings(results=tmp_path, seed=5))
    words = ["reproduce", "figures", "--results", str(tmp_path), "--seed", "5", "--out", str(tmp_path / "b")]
    assert main([*words, "--only", "meta-loss"]) == 0
    again = [tmp_path / "b" / f"meta-loss.{kind}" for kind in ("png", "pdf")]
    assert capsys.readouterr().out.splitlines() == [str(path) for path in again]
    assert [file.name for file in made] == ["meta-loss.png", "meta-loss.pdf"]
    png, pdf = (file.read_bytes() for file in made)
    assert png.startswith(b"\x89PNG")
    assert pdf.startswith(b"%PDF")
    assert b"CreationDate" not in pdf
    assert b"/Type3" not in pdf
    assert [file.read_bytes() for file in again] == [png, pdf]
    assert {path.name for path in (tmp_path / "a").iterdir()} == {"meta-loss.png", "meta-loss.pdf"}


def test_the_command_refuses_a_figure_that_it_does_not_know(tmp_path, capsys):
    assert main(["reproduce", "figures", "--out", str(tmp_path / "out"), "--only", "metaloss"]) == 2
    said = capsys.readouterr().err
    assert said.startswith("usnet: only must be one of")
    assert "did you mean 'meta-loss'?" in said


def test_the_command_lists_every_figure(capsys):
    assert main(["reproduce", "figures", "--help"]) == 0
    shown = capsys.readouterr().out
    assert all(f"\n    {name} " in shown for name in NAMES)


def test_missing_rows_are_one_sentence(tmp_path):
    for name in ("meta-loss", "purity", "rounds", "detection-rates"):
        with pytest.raises(ArgumentError, match=r"^results must be a folder with rows in .*seed2022.csv, got"):
            make_figures(tmp_path / "out", only=[name], settings=Settings(results=tmp_path))
    assert not (tmp_path / "out").exists()


def test_without_matplotlib_the_extra_is_named_before_anything_is_computed(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'usnet\[render\]'"):
        make_figures(tmp_path, only=["example-m8-n185"], settings=Settings(detector_p2="no detector"))


def test_a_place_that_cannot_be_written_is_one_sentence(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ArgumentError, match=r"^path must be a file that can be written"):
        write_figure(new_figure(1, 1), tmp_path / "file" / "name")


def test_figures_of_attention_share_one_answer(tmp_path, monkeypatch):
    """Both figures of the cluster with m = 15 are drawn from one training, by the detector of P1."""
    asked = []
    real = figures.attention.make_detector
    figures.attention.detect_head.cache_clear()
    monkeypatch.setattr(figures.attention, "make_detector", lambda name: asked.append(name) or real(name))
    settings = Settings(detector_p1="gassl(steps=1)")
    for name in ("hierarchy-f1-m15", "attention-heads-f1-m15"):
        FIGURES[name](settings)
    assert asked == [settings.detector_p1]


def test_purity_is_drawn_for_every_strategy():
    figure = purity.draw_strategies(purity_rows(), "title")
    axes = figure.axes[0]
    assert [tick.get_text() for tick in axes.get_xticklabels()] == ["f1", "f2", "all"]
    assert [bars.get_label() for bars in axes.containers] == [
        "K-Means, raw metres",
        "K-Means, scaled inputs",
        "metric learning (GRU and K-Means)",
    ]
    assert list(axes.containers[0].lines[0].get_ydata()) == pytest.approx([0.5, 0.5, 0.5])
    estimated = [row for row in purity_rows() if row.count != "given"]
    with pytest.raises(ArgumentError, match="rows must hold"):
        purity.draw_strategies(estimated, "title")


def test_the_example_is_the_first_episode_of_the_rounds():
    from detectors.studies.rounds import Cell, play_games

    record = example.play_example("lagged-regression", 7, clusters=3, uavs=24)
    (row,) = play_games([(Cell("lagged-regression", "f1", 3, 24), 0)], 7)
    assert record.rounds == row.rounds
    assert record.objective[-1] == pytest.approx(row.J)
    assert record.attention.shape == (record.rounds, 24, 24)


def test_the_example_shows_truth_rounds_and_rates():
    record = example.play_example("lagged-regression", 7, clusters=3, uavs=24)
    figure = example.draw_example(record)
    truth, *shown, rates = (axes for axes in figure.axes if axes.get_visible())
    assert truth.get_title(loc="left") == "Truth: 3 clusters, 24 UAVs"
    assert len(shown) == record.rounds
    strong = (record.attention[0] > 0.1) & ~np.eye(24, dtype=bool)
    assert len(shown[0].collections[0].get_segments()) == strong.sum() > 0
    np.testing.assert_allclose(rates.lines[0].get_ydata(), np.append(0, np.cumsum(record.hits)) / 3 * 100)
    np.testing.assert_allclose(rates.lines[1].get_ydata(), np.append(0, np.cumsum(record.redundant)) / 24 * 100)


def test_long_examples_are_cut_and_say_so():
    record = example.play_example("none", 7, clusters=2, uavs=12)
    titles = [axes.get_title(loc="left") for axes in example.draw_example(record).axes]
    assert record.rounds == 20
    assert "Round 20: 0 hit, 0 redundant  (16 rounds before it are not shown)" in titles
    assert len(titles) == 6


def test_the_committed_rows_are_those_of_the_figures():
    """The default files are the committed ones, so that the figures can be made in a fresh checkout."""
    from pathlib import Path

    results = Path(__file__).parents[3] / Settings.results
    for file in (
        "metric_learning/losses-F30-E1000-seed2022.csv",
        "purity/purity-seed2022.csv",
        "rounds/rounds-seed2022.csv",
        "table2/episodes-seed2022.csv",
    ):
        with (results / file).open(encoding="utf-8") as rows:
            assert next(csv.reader(rows))
