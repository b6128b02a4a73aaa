"""The list of mutants matches the code; the slow test runs all of them."""

import importlib.util
import sys
from pathlib import Path

import pytest

_SPEC = importlib.util.spec_from_file_location("run_mutants", Path(__file__).with_name("run.py"))
run_mutants = importlib.util.module_from_spec(_SPEC)
sys.modules["run_mutants"] = run_mutants
_SPEC.loader.exec_module(run_mutants)

MUTANTS = run_mutants.read_mutants()
READY = [mutant for mutant in MUTANTS if not mutant.pending]


def test_the_numbers_are_1_to_n():
    assert [mutant.number for mutant in MUTANTS] == list(range(1, len(MUTANTS) + 1))


@pytest.mark.parametrize("mutant", READY, ids=lambda mutant: f"{mutant.number}")
def test_a_mutant_applies(mutant):
    assert mutant.count_old() == 1
    assert mutant.old != mutant.new
    assert mutant.tests
    assert not mutant.missing_tests()


def test_the_table_lists_every_mutant_and_no_survivor():
    text = run_mutants.TABLE.read_text(encoding="utf-8")
    assert run_mutants.table(MUTANTS, run_mutants.read_table()) == text
    assert run_mutants.SURVIVES not in run_mutants.read_table().values()


@pytest.mark.slow
@pytest.mark.parametrize("mutant", READY, ids=lambda mutant: f"{mutant.number}")
def test_a_mutant_is_killed(mutant):
    assert run_mutants.run_mutant(mutant) != run_mutants.SURVIVES
