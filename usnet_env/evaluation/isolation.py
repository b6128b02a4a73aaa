"""Play a detector in its own process, which never holds an environment: it receives windows and a seed."""

from __future__ import annotations

import re
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from secrets import token_hex
from typing import Any

import numpy as np
from numpy.typing import NDArray

from usnet_env.config import ArgumentError, quote
from usnet_env.detection import Detection, fit_window
from usnet_env.evaluation.agents import Agent, Answer, DetectorAgent, RefusedArgumentError, as_agent
from usnet_env.evaluation.errors import not_started
from usnet_env.evaluation.parts import send
from usnet_env.processes import Arrays, Limits, PlainError, PlainFunction, PlainProcess, SendError
from usnet_env.window import Window

_ALONE = ""  # the name of an observation that is no mapping
_EXTRAS = ("probability", "attention_heads", "features", "heads")  # the arrays of them that an episode file keeps
_MOST_NUMBERS = 2**21  # of an array of a whole detection; a larger one stays where it is
_OWN_ERRORS = {"ArgumentError": ArgumentError, "RefusedArgumentError": RefusedArgumentError}


def make_secret(secret: Any) -> str:
    """Return the secret of a run: 32 hexadecimal digits, drawn from the random numbers of the system if ``None``.

    Raises:
        ArgumentError: ``secret`` is something else.
    """
    if secret is None:
        return token_hex(16)
    if not isinstance(secret, str) or not re.fullmatch("[0-9a-f]{32}", secret):
        raise ArgumentError(f"secret must be None or 32 hexadecimal digits (0 to 9, a to f), got {quote(secret)}.")
    return secret


def _make_answering(detector: Any) -> PlainFunction:
    """Make an agent, in the detector's process, and return the function that answers calls."""
    return partial(_answer, as_agent(detector))


def _answer(agent: Agent, values: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> tuple[dict[str, Any], Arrays]:
    """Call the agent, in the detector's process."""
    observation = arrays[_ALONE] if _ALONE in arrays else {name: array[()] for name, array in arrays.items()}
    if values["call"] == "reset":
        agent.reset(values["seed"])
    elif values["call"] == "warm_up":
        agent.warm_up(observation)
    elif values["call"] == "detect":
        return _detect(agent, observation)
    else:
        answer = agent.answer(observation)
        parts = {"candidates": answer.candidates, "scores": answer.scores, "clusters": answer.clusters}
        return {}, {name: part for name, part in parts.items() if part is not None}
    return {}, {}


def _detect(agent: Agent, observation: Any) -> tuple[dict[str, Any], Arrays]:
    """The whole detection of a detector as plain data, in the detector's process."""
    if not isinstance(agent, DetectorAgent):
        raise ArgumentError("detector must have the method detect(window), got a policy.")
    found = agent.detector.detect(fit_window(agent.detector, Window.from_observation(observation)))
    if not isinstance(found, Detection):
        raise ArgumentError(f"detect must return a usnet_env.Detection, got {quote(found)}.")
    arrays = {name: getattr(found, name) for name in ("candidates", "scores", "clusters", "leader", "attention")}
    arrays |= {f"extras.{name}": _as_numbers(found.extras.get(name)) for name in _EXTRAS}
    kept = {name: part for name, part in arrays.items() if part is not None and part.size <= _MOST_NUMBERS}
    reasons = found.extras.get("reasons")
    return {"reasons": [str(each) for each in reasons] if isinstance(reasons, list | tuple) else []}, kept


def _as_numbers(values: Any) -> NDArray[Any] | None:
    """The values as an array of numbers; ``None`` if they are something else."""
    try:
        array = np.asarray(values)
    except (TypeError, ValueError):
        return None
    return array if array.dtype.kind in "biuf" else None


class IsolatedAgent:
    """An agent whose detector or policy runs in a process of its own.

    The process holds neither an environment nor the seeds of swarms, and inherits no memory; its answers are read as
    numbers, never as objects. The seconds of an answer are measured in this process, with the way there and back.

    Args:
        detector: a name as :func:`usnet_env.make_detector` takes it, so that only the detector's process loads its
            code, or an object, of which that process gets a copy.
        limits: of each answer and each reset.

    Raises:
        ArgumentError: the object cannot be sent to another process.
        EvaluationError: the process could not start.
    """

    def __init__(self, detector: Any, limits: Limits) -> None:
        with _own_errors():
            self._process = PlainProcess(send(partial(_make_answering, detector), kinds=("detector",)), limits)

    def start(self) -> None:
        """Wait until the detector is made.

        Raises:
            ArgumentError: there is no such detector, it refuses an argument, or it could not be sent.
            PlainError, ProcessDied: making it failed.
            EvaluationError: the process did not start.
        """
        with _own_errors():
            self._process.start()

    def reset(self, seed: int) -> None:
        """Start an episode."""
        self._call("reset", seed=seed)

    def warm_up(self, observation: Any) -> None:
        """Answer once without being timed."""
        self._call("warm_up", observation)

    def answer(self, observation: Any) -> Answer:
        """Return the answer to one observation."""
        begin = time.perf_counter()
        parts = self._call("answer", observation)
        seconds = time.perf_counter() - begin
        if not {"candidates", "scores"} <= parts.keys() <= {"candidates", "scores", "clusters"}:
            raise ArgumentError(f"an answer must hold candidates and scores, got {quote(sorted(parts))}.")
        checked = Detection(**parts)
        return Answer(checked.candidates, checked.scores, checked.clusters, seconds)

    def detect(self, window: Window) -> Detection:
        """Return the detector's whole answer to a window, with all that an episode file keeps of it."""
        seen = {name: getattr(window, name) for name in ("position", "velocity", "seen", "alive", "round", "step")}
        values, parts = self._exchange("detect", {name: part for name, part in seen.items() if part is not None})
        extras = {name: parts.pop(key) for name in _EXTRAS if (key := f"extras.{name}") in parts}
        reasons, heads = values.get("reasons"), extras.get("heads", np.empty(0))
        if isinstance(reasons, list) and heads.dtype.kind in "iu" and heads.ndim == 1:
            extras["reasons"] = [str(each) for each in reasons]
        else:
            extras.pop("heads", None)
        if not {"candidates", "scores"} <= parts.keys() <= {"candidates", "scores", "clusters", "leader", "attention"}:
            raise ArgumentError(f"an answer must hold candidates and scores, got {quote(sorted(parts))}.")
        return Detection(**parts, extras=extras)

    def close(self) -> None:
        """End the process."""
        self._process.close()

    def _call(self, what: str, observation: Any = None, **values: Any) -> dict[str, Any]:
        seen = {} if observation is None else observation if isinstance(observation, Mapping) else {_ALONE: observation}
        return self._exchange(what, seen, **values)[1]

    def _exchange(self, what: str, seen: Mapping[str, Any], **values: Any) -> tuple[dict[str, Any], dict[str, Any]]:
        with _own_errors():
            return self._process.call({"call": what, **values}, {name: np.asarray(part) for name, part in seen.items()})


@contextmanager
def _own_errors() -> Iterator[None]:
    """Turn the errors of an argument, which another process raised, into those of this one."""
    try:
        yield
    except SendError as error:
        if not error.started:
            raise not_started(error) from None
        raise ArgumentError(
            f"isolate must be false for a detector that cannot be sent to another process: {error}."
        ) from None
    except PlainError as error:
        if error.kind in _OWN_ERRORS:
            raise _OWN_ERRORS[error.kind](error.text) from error
        raise
