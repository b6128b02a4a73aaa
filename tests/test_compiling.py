"""Compiled loops: of several processes that need the same code, one compiles it at a time."""

from __future__ import annotations

import threading

import numpy as np
import pytest
from numba.core import caching, config

from usnet_env import compiling
from usnet_env.compiling import compiled

fcntl = pytest.importorskip("fcntl")


def twice(number):
    return 2 * number


def test_a_function_is_not_compiled_while_another_process_compiles_it(tmp_path, monkeypatch):
    monkeypatch.setattr(config, "CACHE_DIR", str(tmp_path))
    loop = compiled()(twice)
    assert loop(1.5) == 3.0
    (lock,) = tmp_path.rglob("*.lock")
    found = []
    waiting = threading.Thread(target=lambda: found.append(loop(1)))
    with lock.open() as other:
        fcntl.flock(other, fcntl.LOCK_EX)  # an open file of its own, as in another process
        waiting.start()
        waiting.join(0.3)
        assert not found
        fcntl.flock(other, fcntl.LOCK_UN)
        waiting.join(600)
        assert found == [2]
        fcntl.flock(other, fcntl.LOCK_EX | fcntl.LOCK_NB)  # it was given back
    assert len(loop.signatures) == 2
    again = compiled()(twice)  # as in another process, which finds both
    assert (again(2.5), again(2)) == (5.0, 4)
    assert len(again.stats.cache_hits) == 2
    assert not again.stats.cache_misses


def sum_up(values):
    total = np.float32(0.0)
    for value in values:
        total += value * value
    return total


def test_a_function_computes_the_same_whoever_calls_it_first(tmp_path, monkeypatch):
    monkeypatch.setattr(config, "CACHE_DIR", str(tmp_path))
    values = np.random.default_rng(0).normal(size=1001).astype(np.float32)
    alone = sum_up(values)  # in the order in which it is written
    part = compiled()(sum_up)

    def call(values):
        return part(values)

    compiled(fastmath={"reassoc", "contract"})(call)(values)
    assert part(values) == alone
    again = compiled()(sum_up)  # another process, which reads the cache
    assert again(values) == alone
    assert again.stats.cache_hits


def test_loops_compile_where_no_cache_folder_can_be_written(monkeypatch):
    monkeypatch.setattr(caching.CacheImpl, "_locator_classes", [])  # Numba finds no folder
    assert compiled()(twice)(3) == 6


def test_a_person_hears_once_that_it_takes_long(tmp_path, monkeypatch):
    monkeypatch.setattr(config, "CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(compiling, "_LONG", 0.0)
    said = []
    compiling.tell_if_long(said.append)
    loop = compiled()(lambda number: number + 3)
    assert (loop(1.5), loop(1)) == (4.5, 4)
    assert len(said) == 1
    assert said[0].startswith("compiling")
