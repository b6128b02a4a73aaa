"""``usnet train``: small trainings from the command line, and what they refuse at once."""

import json

import pytest
from click.testing import CliRunner

from detectors.commands import train
from usnet_env.config import ArgumentError


@pytest.mark.parametrize("seed", [0, 3])
def test_a_training_writes_its_files_and_prints_the_path(tmp_path, seed):
    words = ["meta", "--strategies", "1", "--episodes", "2", "--method", "joint", *(["--seed", "3"] if seed else [])]
    done = CliRunner().invoke(train, [*words, "--out", str(tmp_path)], catch_exceptions=False)
    assert done.exit_code == 0
    assert str(tmp_path) in done.stdout
    assert json.loads((tmp_path / "joint.json").read_text())["training"]["seed"] == seed


def test_a_folder_that_cannot_be_written_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ArgumentError, match="out must be a folder that can be written"):
        CliRunner().invoke(train, ["meta", "--out", str(tmp_path / "file" / "out")], catch_exceptions=False)
