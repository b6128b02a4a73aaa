"""The examples in docstrings show what Python prints."""

import doctest
import importlib

import pytest

SWARM = [f"usnet_env.swarm.{name}" for name in ("config", "simulator", "state", "strategy")]


@pytest.mark.parametrize("name", SWARM)
def test_examples_are_right(name):
    failed, examples = doctest.testmod(importlib.import_module(name))
    assert examples > 0
    assert failed == 0
