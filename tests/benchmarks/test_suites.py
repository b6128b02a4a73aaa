"""Rows of a detector that joins later are added to those of the others, if all met the same swarms."""

import csv
import gzip
import io
from pathlib import Path

import pytest
import suites
from result_pages.suites import describe_suite, read_failures, read_suite

from usnet_env import Detection, Window
from usnet_env.evaluation import FrozenSuite, evaluate_suite, load_suite

TEXT = """
version: 3
purpose: For a test.
episodes: 2
seed: 5000
tuning_seed: 5
arguments: {clusters: 2, uavs: 12, observation_steps: 10, max_rounds: 2}
cells: {plain: {}, noise: {position_noise: 0.2}}
"""


@pytest.fixture
def small(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> FrozenSuite:
    (tmp_path / "small.yaml").write_text(TEXT)
    suite = load_suite(tmp_path / "small.yaml")
    monkeypatch.setattr(suites, "load_suite", {"small": suite}.__getitem__)
    return suite


def rows_of(path: Path) -> list[tuple[str, str, str]]:
    text = gzip.decompress(path.read_bytes()).decode()
    return [(row["cell"], row["detector"], row["episode"]) for row in csv.DictReader(io.StringIO(text))]


def test_a_later_detector_is_added_and_others_stay(small: FrozenSuite, tmp_path: Path) -> None:
    first, second, other = (tmp_path / name / "small" for name in ("first", "second", "other"))
    evaluate_suite(small, ["none", "destroy-all"], isolate=False, out=first)
    evaluate_suite(small, "random", isolate=False, out=second)
    path = suites.pack([first], results=tmp_path)
    before = path.read_bytes()
    assert suites.pack([second], add=True, results=tmp_path) == path
    rows = rows_of(path)
    detectors = ("random", "none", "destroy-all")
    assert sorted(rows) == sorted((cell, name, k) for cell in small.cells for name in detectors for k in ("0", "1"))
    assert [cell for cell, *_ in rows] == ["plain"] * 6 + ["noise"] * 6
    assert suites.pack([second], add=True, results=tmp_path).read_bytes() == path.read_bytes()
    assert suites.pack([first], results=tmp_path).read_bytes() == before
    evaluate_suite(small, "random", isolate=False, out=other, seed=6000)
    with pytest.raises(ValueError, match="must be of the same swarms"):
        suites.pack([other], add=True, results=tmp_path)
    assert path.read_bytes() == before


def test_a_detector_that_did_not_play_all_cells_is_refused(small: FrozenSuite, tmp_path: Path) -> None:
    evaluate_suite(small, "none", isolate=False, out=tmp_path / "small", cells=["plain"])
    with pytest.raises(
        ValueError, match=r"the same episodes of every cell of small .*; some lack: \['none in noise'\]"
    ):
        suites.pack([tmp_path / "small"], results=tmp_path)


def test_a_slow_detector_may_play_the_first_episodes_of_each_cell(small: FrozenSuite, tmp_path: Path) -> None:
    first, second = (tmp_path / name / "small" for name in ("first", "second"))
    evaluate_suite(small, "none", isolate=False, out=first)
    evaluate_suite(small, "destroy-all", isolate=False, out=second, episodes=1)
    rows = rows_of(suites.pack([first, second], results=tmp_path))
    assert [row for row in rows if row[1] == "destroy-all"] == [(cell, "destroy-all", "0") for cell in small.cells]
    page = "\n".join(describe_suite(small, read_suite(small, tmp_path)))
    assert "only the first episodes of each cell: `destroy-all` 1 of 2." in page
    evaluate_suite(small, "destroy-all", isolate=False, out=second, cells=["plain"])
    with pytest.raises(ValueError, match=r"some lack: \['destroy-all in noise'\]"):
        suites.pack([second], results=tmp_path)


class Sometimes:
    """Answers in one cell, and fails in the other."""

    def reset(self, seed: int | None = None) -> None:
        """Nothing to prepare."""

    def detect(self, window: Window) -> Detection:
        if not window.seen.all():
            raise RuntimeError("a UAV is not seen")
        return Detection(window.alive, window.alive)


def test_a_cell_in_which_a_detector_failed_is_kept_with_its_reason(tmp_path: Path, monkeypatch) -> None:
    (tmp_path / "small.yaml").write_text(TEXT.replace("{position_noise: 0.2}", "{miss_rate: 0.3}"))
    small = load_suite(tmp_path / "small.yaml")
    monkeypatch.setattr(suites, "load_suite", {"small": small}.__getitem__)
    first, second = (tmp_path / name / "small" for name in ("first", "second"))
    evaluate_suite(small, {"sometimes": Sometimes()}, isolate=False, out=first)
    evaluate_suite(small, "none", isolate=False, out=second)
    path = suites.pack([first, second], results=tmp_path)
    assert sorted(rows_of(path)) == sorted(
        [("plain", "sometimes", "0"), ("plain", "sometimes", "1")]
        + [(cell, "none", k) for cell in small.cells for k in ("0", "1")]
    )
    ((cell, detector, reason),) = (row.values() for row in read_failures(small, tmp_path))
    assert (cell, detector) == ("noise", "sometimes")
    assert "a UAV is not seen" in reason
    evaluate_suite(small, "random", isolate=False, out=tmp_path / "third" / "small")
    suites.pack([tmp_path / "third" / "small"], add=True, results=tmp_path)
    assert len(read_failures(small, tmp_path)) == 1
    assert len(rows_of(path)) == 10
