"""A child process that exchanges numbers, texts and arrays with its parent, and never objects.

An object that is unpickled can run code of its sender. What a process that is not trusted sends is therefore read as
data only: a header in JSON, and the bytes of the arrays.
"""

from __future__ import annotations

import json
import math
import os
import select
import struct
import time
import traceback
from collections.abc import Callable, Mapping
from contextlib import suppress
from multiprocessing.connection import Connection
from multiprocessing.reduction import ForkingPickler
from multiprocessing.util import Finalize
from typing import Any

import numpy as np
from numpy.typing import NDArray

from usnet_env.processes.child import prepare_child
from usnet_env.processes.frames import describe_place
from usnet_env.processes.limits import Limits, ProcessDied, limit_memory
from usnet_env.processes.parent import (
    RemoteTraceback,
    SendError,
    describe_end,
    end_process,
    pickle_function,
    start_process,
)

Arrays = Mapping[str, NDArray[Any]]
#: Takes plain values and arrays, and returns plain values and arrays; the arrays that it gets are its own.
PlainFunction = Callable[[dict[str, Any], dict[str, NDArray[Any]]], tuple[Mapping[str, Any], Arrays]]

_ALIGNED = 16  # bytes
_KINDS = "biuf"  # of arrays: booleans and numbers
_LARGEST_ANSWER = 2**26  # bytes
_LONGEST_TEXT = 10_000  # characters of an error
_LONGEST_PLACE = 200  # characters
_SMALL = 2**15  # bytes; a longer message waits until the process reads it
_AT_ONCE = 2**20  # bytes
_LENGTH = struct.Struct("!i")  # of a message, as multiprocessing's connections send it
_POLL = 1.0  # seconds; a process whose death no pipe reports, because a child of its own holds the pipe, is found then
_GRACE = 5.0  # seconds


class PlainError(RuntimeError):
    """The function of a child process raised an exception.

    Args:
        kind: the name of the exception's class.
        text: the exception as text.
        place: the line of foreign code that raised it, as :func:`describe_place` returns it.
    """

    def __init__(self, kind: str, text: str, place: str = "") -> None:
        super().__init__(kind, text, place)
        self.kind = kind
        self.text = text
        self.place = place

    def __str__(self) -> str:
        return f"{self.kind}: {self.text}".rstrip(": ")


def _pack(values: Mapping[str, Any], arrays: Arrays) -> bytes:
    """Encode plain values and arrays.

    Raises:
        TypeError: a value or an array is of another kind.
    """
    contiguous = {name: np.ascontiguousarray(array).reshape(np.shape(array)) for name, array in arrays.items()}
    if any(array.dtype.kind not in _KINDS for array in contiguous.values()):
        raise TypeError("arrays must hold numbers or booleans")
    shapes = [(name, array.dtype.str, array.shape) for name, array in contiguous.items()]
    header = json.dumps([values, shapes]).encode()
    header += b" " * (-(len(header) + 8) % _ALIGNED)
    parts = [len(header).to_bytes(8, "little"), header]
    for array in contiguous.values():
        parts += [array.tobytes(), bytes(-array.nbytes % _ALIGNED)]
    return b"".join(parts)


def _unpack(data: bytes) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Decode what :func:`_pack` has encoded; the arrays can be written to.

    Raises:
        ValueError: the data are something else.
    """
    try:
        start = 8 + int.from_bytes(data[:8], "little")
        values, shapes = json.loads(data[8:start])
        own, arrays = bytearray(data), {}
        if not isinstance(values, dict):
            raise ValueError("no plain data")
        for name, dtype, shape in shapes:
            kind = np.dtype(dtype)
            if kind.kind not in _KINDS:
                raise ValueError("no plain data")
            count = int(np.prod(shape, dtype=np.int64))
            arrays[str(name)] = np.frombuffer(own, kind, count, start).reshape(shape)
            start += -(-count * kind.itemsize // _ALIGNED) * _ALIGNED
    except (ValueError, TypeError, KeyError, OverflowError, MemoryError, RecursionError) as error:
        raise ValueError(f"no plain data: {error}") from None
    return values, arrays


def _serve(connection: Connection, megabytes: float | None) -> None:
    """Make the function, then answer messages until the connection closes; the main function of the child process."""
    prepare_child()
    pid = os.getpid()
    with suppress(EOFError, OSError):
        connection.send_bytes(_pack({}, {}))  # it has started: the main script could be imported
        data = connection.recv_bytes()
        try:
            make = ForkingPickler.loads(data)  # from the parent, which is trusted
        except BaseException as error:
            connection.send_bytes(_describe(error, "SendError", f"{type(error).__name__}: {_text(error)}"))
            return
        try:
            function, answer = make(), _pack({}, {})
        except BaseException as error:
            answer = _describe(error, type(error).__name__, _text(error))
        while True:
            if os.getpid() != pid:  # a copy of the process, made by os.fork in the function, must not go on as well
                os._exit(1)
            connection.send_bytes(answer)
            data = connection.recv_bytes()
            try:
                with limit_memory(megabytes):
                    answer = _pack(*function(*_unpack(data)))
            except BaseException as error:
                answer = _describe(error, type(error).__name__, _text(error))


def _describe(error: BaseException, kind: str, text: str) -> bytes:
    trace = "".join(traceback.format_exception(error))
    parts = {"text": text[:_LONGEST_TEXT], "trace": trace[-_LONGEST_TEXT:], "place": describe_place(error)}
    return _pack({"error": kind, **parts}, {})


def _text(error: BaseException) -> str:
    try:
        return str(error)
    except Exception:
        return ""


class PlainProcess:
    """Calls a function in a child process of its own.

    The process gets what makes the function, once, and after that only plain values and arrays. It ends with the
    parent, and with :meth:`close`.

    Args:
        make: makes the function in the child process, while this one goes on; it is pickled.
        limits: of each call.

    Raises:
        SendError: ``make`` cannot be sent, or the process could not start.
    """

    def __init__(self, make: Callable[[], PlainFunction], limits: Limits) -> None:
        self._make = pickle_function(make)
        if os.name == "nt":
            raise SendError("this needs Linux or macOS")
        self._seconds = limits.seconds
        self._started = False
        self._reason = "its process was closed"
        self._process, self._connection = start_process(_serve, limits.megabytes)
        # Before the program waits for its children at its end; a garbage collection is no reason to wait for that.
        self._end = Finalize(self, end_process, (self._process, self._connection), exitpriority=10)
        os.set_blocking(self._connection.fileno(), False)
        if len(self._make) < _SMALL:
            self._send(self._make, math.inf)

    def start(self) -> None:
        """Wait until the function is made; there is no limit of time and memory.

        Raises:
            PlainError: ``make`` raised an exception.
            ProcessDied: the process ended.
            SendError: ``make`` could not be unpickled, or the process did not start.
        """
        if self._started:
            return
        if not self._connection.closed:
            try:
                self._exchange(None, None)  # it says that it runs
            except ProcessDied as error:
                raise SendError(f"a worker process did not start: {error.reason}", started=False) from None
        self._exchange(None if len(self._make) < _SMALL else self._make, None)
        self._started = True

    def call(self, values: Mapping[str, Any], arrays: Arrays) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
        """Call the function, once it is made.

        Args:
            values: plain values, as JSON has them.
            arrays: arrays of numbers and booleans.

        Returns:
            What the function returned. It comes from a process that is not trusted.

        Raises:
            PlainError: the function raised an exception.
            ProcessDied: the process ended, took too long, or sent something else than an answer.
            TypeError: a value or an array is of another kind.
        """
        message = _pack(values, arrays)
        self.start()
        return self._exchange(message, self._seconds)

    def close(self) -> None:
        """Kill the process."""
        self._end()

    def _exchange(self, message: bytes | None, seconds: float | None) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
        """Send a message, if there is one, and return the answer."""
        if self._connection.closed:
            raise ProcessDied(self._reason)
        deadline = math.inf if seconds is None else time.monotonic() + seconds
        try:
            if message is not None:
                self._send(message, deadline)
            values, arrays = _unpack(self._receive(deadline))
        except TimeoutError:
            raise self._bury(f"it took longer than {seconds:g} seconds, the time limit") from None
        except ValueError:
            raise self._bury("it sent something else than an answer") from None
        except (EOFError, OSError):
            self._process.join(_GRACE)  # the connection closes a moment before the process has its exit status
            raise self._bury(describe_end(self._process)) from None
        except BaseException:  # such as an interrupt: an answer may still come
            self.close()
            raise
        if "error" not in values:
            return values, arrays
        kind, text, trace, place = (str(values.get(name, "")) for name in ("error", "text", "trace", "place"))
        if not self._started:
            self.close()
            if kind == "SendError":
                raise SendError(text)
        raise PlainError(kind, text, " ".join(place.split())[:_LONGEST_PLACE]) from RemoteTraceback(trace)

    def _send(self, message: bytes, deadline: float) -> None:
        """Send a message as the connection of the child process reads it, its length first."""
        left = memoryview(_LENGTH.pack(len(message)) + message)
        while left:
            self._wait(select.POLLOUT, deadline)
            with suppress(BlockingIOError):
                left = left[os.write(self._connection.fileno(), left) :]

    def _receive(self, deadline: float) -> bytes:
        """Receive an answer as the connection of the child process sends it.

        Raises:
            ValueError: its length is none of an answer.
        """
        (length,) = _LENGTH.unpack(self._read(_LENGTH.size, deadline))
        if not 0 <= length <= _LARGEST_ANSWER:
            raise ValueError("no length of an answer")
        return self._read(length, deadline)

    def _read(self, count: int, deadline: float) -> bytes:
        parts = bytearray()
        while len(parts) < count:
            self._wait(select.POLLIN, deadline)
            with suppress(BlockingIOError):
                part = os.read(self._connection.fileno(), min(count - len(parts), _AT_ONCE))
                if not part:
                    raise EOFError
                parts += part
        return bytes(parts)

    def _wait(self, event: int, deadline: float) -> None:
        """Wait until the connection is ready for an event; a process that has ended may still have sent something."""
        poll = select.poll()
        poll.register(self._connection.fileno(), event)
        while True:
            left = min(_POLL, deadline - time.monotonic())
            if left < 0:
                raise TimeoutError
            ended = self._process.exitcode is not None  # asked first: all that it sent can then be read
            if poll.poll(1000 * left):
                return
            if ended:
                raise EOFError

    def _bury(self, reason: str) -> ProcessDied:
        """End the process; returns the error with the reason."""
        self._reason = reason
        self.close()
        return ProcessDied(reason)
