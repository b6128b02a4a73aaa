"""Processes that exchange data only: what they send is never an object, and whatever ends them is an error."""

from __future__ import annotations

import sys
from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from sample_tasks import make_plain

from usnet_env.processes import Limits, PlainError, PlainProcess, ProcessDied, SendError
from usnet_env.processes.plain import _pack, _unpack

ARRAYS = hnp.arrays(
    st.sampled_from([np.bool_, np.int8, np.int64, np.float32, np.float64]), hnp.array_shapes(min_dims=0, min_side=0)
)


@given(st.dictionaries(st.text(max_size=5), st.integers() | st.text()), st.dictionaries(st.text(max_size=5), ARRAYS))
def test_any_plain_data_come_back(values, arrays):
    own, copies = _unpack(_pack(values, arrays))
    assert own == values
    assert copies.keys() == arrays.keys()
    for name, array in arrays.items():
        assert copies[name].dtype == array.dtype
        assert copies[name].shape == array.shape
        assert copies[name].tobytes() == array.tobytes()
        assert copies[name].flags.writeable


@given(st.binary(max_size=200))
def test_any_other_bytes_are_no_data(data):
    with pytest.raises(ValueError, match="no plain data"):
        _unpack(data)


def test_objects_are_no_data():
    with pytest.raises(TypeError):
        _pack({}, {"objects": np.array([object()])})
    with pytest.raises(TypeError):
        _pack({"object": object()}, {})


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="memory is limited on Linux only")
def test_whatever_a_process_does_is_an_answer_or_an_error(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)

    def start():
        return PlainProcess(make_plain, Limits(seconds=2, megabytes=200))

    processes = [start() for _ in range(2)]  # they start together
    process = processes.pop()
    assert process.call({"do": "sum"}, {"a": np.arange(4)})[1]["sum"] == 6
    with pytest.raises(PlainError, match=r"^KeyError: 'raise'$") as raised:
        process.call({"do": "raise"}, {})
    assert "sample_tasks.py" in str(raised.value.__cause__)
    with pytest.raises(PlainError, match=r"^MemoryError: it needed more than 200 MB, the memory limit$"):
        process.call({"do": "memory"}, {})
    with pytest.raises(PlainError, match=r"^SystemExit: 3$"):
        process.call({"do": "sys.exit"}, {})
    assert process.call({"do": "sum"}, {"a": np.ones(10**6)})[1]["sum"] == 10**6
    with pytest.raises(ProcessDied, match="it took longer than 2 seconds, the time limit"):
        process.call({"do": "hang"}, {})
    with pytest.raises(ProcessDied, match="it took longer than 2 seconds"):  # it stays dead, with the same reason
        process.call({"do": "sum"}, {"a": np.arange(4)})
    process = processes.pop()
    with pytest.raises(ProcessDied, match="it sent something else than an answer"):
        process.call({"do": "send an object"}, {})
    assert list(tmp_path.iterdir()) == []  # the object was not unpickled


@pytest.mark.slow
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="it counts on signals and forks")
@pytest.mark.parametrize(
    ("what", "reason"),
    [
        ("exit", "it ended its process with status 0"),
        ("kill", "its process was killed by SIGKILL"),
        ("fork and exit", "it ended its process with status 0"),
        ("half an answer", "it took longer than 2 seconds"),
        ("stop", "it took longer than 2 seconds"),
        ("close", "its process|it ended its process"),
    ],
)
def test_ends_of_processes(what, reason):
    process = PlainProcess(make_plain, Limits(seconds=2))

    def call_twice():
        process.call({"do": what}, {"large": np.zeros(10**6)})
        process.call({"do": "sum"}, {"a": np.zeros(10**6)})  # a process that stops after its answer reads no more

    with pytest.raises(ProcessDied, match=reason):
        call_twice()


def test_what_cannot_be_sent_or_made_is_refused():
    with pytest.raises(SendError, match="lambda"):
        PlainProcess(partial(make_plain, lambda: None), Limits())
    process = PlainProcess(partial(make_plain, "broken"), Limits())
    with pytest.raises(PlainError, match=r"^ZeroDivisionError: no function$"):
        process.start()
