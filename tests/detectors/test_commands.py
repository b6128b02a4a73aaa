"""``usnet train``: small trainings from the command line, and what they refuse at once."""

import json

import pytest
from click.testing import CliRunner

from detectors.commands import train
from usnet_env.config import ArgumentError


@pytest.mark.parametrize(
    ("words", "file"),
    [
        (("meta", "--strategies", "1", "--episodes", "2", "--method", "joint"), "joint.json"),
        (("learned", "--steps", "1", "--swarms", "1"), "learned.json"),
        (("follow-mixture", "--swarms", "2", "--seed", "3"), "calibration.json"),
    ],
)
def test_a_training_writes_its_files_and_prints_the_path(tmp_path, words, file):
    done = CliRunner().invoke(train, [*words, "--out", str(tmp_path)], catch_exceptions=False)
    assert done.exit_code == 0
    assert str(tmp_path) in done.stdout
    seed = json.loads((tmp_path / file).read_text())["training"]["seed"]
    assert seed == (3 if "--seed" in words else 0)


@pytest.mark.parametrize("command", ["meta", "learned", "follow-mixture"])
def test_a_folder_that_cannot_be_written_is_refused(tmp_path, command):
    (tmp_path / "file").write_text("")
    with pytest.raises(ArgumentError, match="out must be a folder that can be written"):
        CliRunner().invoke(train, [command, "--out", str(tmp_path / "file" / "out")], catch_exceptions=False)


def test_a_number_out_of_range_is_refused():
    done = CliRunner().invoke(train, ["learned", "--steps", "0"])
    assert done.exit_code == 2
    assert "--steps" in done.output
