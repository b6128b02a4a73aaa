"""The examples in docstrings: each runs, and prints what it says."""

import doctest
from importlib import import_module
from pathlib import Path

import pytest

import usnet_env

ROOT = Path(usnet_env.__file__).parents[1]
FILES = [*(ROOT / "usnet_env").rglob("*.py"), *(ROOT / "detectors").rglob("*.py")]
EXAMPLES = [path for path in FILES if ">>> " in path.read_text(encoding="utf-8")]


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_examples_print_what_they_say(path):
    module = ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
    assert not doctest.testmod(import_module(module)).failed
