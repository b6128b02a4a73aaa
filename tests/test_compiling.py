"""Compiled loops: of several processes that need the same code, one compiles it at a time."""

import os
import shutil
import signal
import sys
import threading
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from numba.core import caching, config, event

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


def test_a_change_in_another_file_compiles_a_function_anew(tmp_path, monkeypatch):
    monkeypatch.setattr(config, "CACHE_DIR", str(tmp_path / "cache"))
    head = "from usnet_env.compiling import compiled\n"
    calls = "@compiled()\ndef {}(number):\n    return {}\n"
    (tmp_path / "outer.py").write_text(head + "from middle import middle\n" + calls.format("outer", "middle(number)"))
    middle = (
        head + "from inner import inner\nfrom shift import SHIFT\n" + calls.format("middle", "inner(number) + SHIFT")
    )
    (tmp_path / "middle.py").write_text(middle)
    monkeypatch.syspath_prepend(tmp_path)

    def run(shift, factor):
        (tmp_path / "shift.py").write_text(f"SHIFT = {shift}")
        (tmp_path / "inner.py").write_text(head + calls.format("inner", f"{factor} * number"))
        for name in ("outer", "middle", "inner", "shift"):
            sys.modules.pop(name, None)
            shutil.rmtree(tmp_path / "__pycache__", ignore_errors=True)  # its times have a second's precision
        outer = import_module("outer").outer
        return outer(1.5), bool(outer.stats.cache_hits)

    assert run(1, 2) == (4.0, False)
    assert run(1, 2) == (4.0, True)
    assert run(1, 4) == (7.0, False)
    assert run(3, 4) == (9.0, False)
    (tmp_path / "middle.py").write_text(middle.replace("+ SHIFT", "- SHIFT"))
    assert run(3, 4) == (3.0, False)


def test_damaged_code_is_compiled_anew(tmp_path, monkeypatch):
    monkeypatch.setattr(config, "CACHE_DIR", str(tmp_path))
    for pattern, size in (("*.nbi", 0), ("*.nbi", 200), ("*.nbc", 0), ("*.nbc", 200)):
        assert compiled()(twice)(1.5) == 3.0
        for path in tmp_path.rglob(pattern):
            os.truncate(path, size)
        assert compiled()(twice)(1.5) == 3.0
        again = compiled()(twice)
        assert again(1.5) == 3.0
        assert again.stats.cache_hits


def test_a_folder_that_takes_no_code_is_one_warning_and_none_at_all_is_fine(tmp_path, monkeypatch):
    monkeypatch.setattr(config, "CACHE_DIR", str(tmp_path))
    loop = compiled()(twice)
    folder = Path(loop.stats.cache_path)
    folder.rmdir()
    folder.write_text("no folder")
    with pytest.warns(UserWarning, match="can't keep machine code in") as found:
        assert (loop(1.5), loop(1)) == (3.0, 2)
    assert len(found) == 1
    monkeypatch.setattr(caching.CacheImpl, "_locator_classes", [])  # Numba finds no folder
    assert compiled()(twice)(3) == 6


def test_an_interruption_waits_until_the_code_is_made(tmp_path, monkeypatch):
    monkeypatch.setattr(config, "CACHE_DIR", str(tmp_path))
    loop, interrupt = compiled()(twice), event.RecordingListener()
    monkeypatch.setattr(interrupt, "on_start", lambda _: signal.raise_signal(signal.SIGINT))
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background job ignores it
    with event.install_listener("numba:compile", interrupt), pytest.raises(KeyboardInterrupt):
        loop(1.5)
    signal.signal(signal.SIGINT, before)
    assert len(loop.signatures) == 1


def test_a_person_hears_once_that_it_takes_long(tmp_path, monkeypatch):
    monkeypatch.setattr(config, "CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(compiling, "_ANNOUNCE_AFTER", 0.0)
    said = []
    compiling.tell_if_long(said.append)
    loop = compiled()(lambda number: number + 3)
    assert (loop(1.5), loop(1)) == (4.5, 4)
    assert len(said) == 1
    assert said[0].startswith("compiling")
