"""The eight checks. Each takes a detector, uses copies of it, and raises :class:`CheckError` with one sentence."""

from __future__ import annotations

import copy
import inspect
import pickle
import random
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any
from unittest import SkipTest

import numpy as np
from scipy.stats import rankdata
from sklearn.base import clone

from detectors.checks.windows import draw_gaps, draw_two_rounds, draw_window, pick_uavs, stop_uavs
from usnet_env.arrays import Floats
from usnet_env.config import ArgumentError, quote
from usnet_env.detection import Detection
from usnet_env.parts import parse_label
from usnet_env.plugins import DETECTORS, detector_label, make_detector
from usnet_env.window import Window

_SEED = 5  # for the detectors' generators
_EPISODES = 8  # per order of the UAVs, for detectors that draw random numbers
_RELABELLINGS = 1999
_LEVEL = 0.002  # a correct detector fails by chance on 1 of 500 windows; all seeds are fixed
_FIELDS = ("candidates", "scores", "clusters", "leader", "attention")


class CheckError(AssertionError):
    """A detector failed a check; the message is one sentence."""


def _require(condition: bool, sentence: str) -> None:
    if not condition:
        raise CheckError(sentence)


def _validate(answer: Any, window: Window) -> Detection:
    """The answer, if it is a detection for all N UAVs and names no destroyed one."""
    _require(isinstance(answer, Detection), f"detect must return a usnet_env.Detection, got {quote(answer)}.")
    named = len(answer.candidates)
    _require(named == window.uavs, f"detect must return candidates for all {window.uavs} UAVs, got {named}.")
    dead = np.flatnonzero(answer.candidates & ~window.alive)
    _require(not len(dead), f"a destroyed UAV must not be a candidate, got UAVs {quote(dead.tolist())}.")
    return answer


def _play(detector: Any, windows: Sequence[Window], seed: int = _SEED) -> list[Detection]:
    """Play an episode: call ``reset(seed)``, then ``detect`` on each window in order."""
    detector.reset(seed)
    return [_validate(detector.detect(window), window) for window in windows]


def _require_same(detections: Sequence[Detection], expected: Sequence[Detection], sentence: str) -> None:
    """Require bitwise equal detections; the names of fields end the sentence."""
    for answer, twin in zip(detections, expected, strict=True):
        pairs = {name: (np.array(getattr(answer, name)), np.array(getattr(twin, name))) for name in _FIELDS}
        different = [name for name, (value, other) in pairs.items() if not np.array_equal(value, other)]
        _require(not different, f"{sentence} {', '.join(different)}.")


def _list_arguments(detector: Any) -> list[str]:
    """The constructor's argument names; skips detectors without scikit-learn's methods."""
    if not callable(getattr(detector, "get_params", None)):
        raise SkipTest("it has no method get_params, so scikit-learn's rules do not apply.")
    return sorted(inspect.signature(type(detector)).parameters)


def check_constructor_only_stores(detector: Any) -> None:
    """The constructor only stores its arguments; ``get_params`` and ``clone`` match, and an episode changes none."""
    names, kind = _list_arguments(detector), type(detector)
    sentinels = {name: object() for name in names}  # no constructor can interpret these
    stored = dict(vars(kind(**sentinels)))
    for name, value in sentinels.items():
        same = stored.pop(name, None) is value
        _require(same, f"the constructor must store {name} unchanged as self.{name}; reset is the place to check it.")
    _require(not stored, f"the constructor must store its arguments only, also got {', '.join(sorted(stored))}.")
    player = copy.deepcopy(detector)
    params = player.get_params(deep=False)
    _require(sorted(params) == names, f"get_params must return {', '.join(names)}, got {quote(sorted(params))}.")
    old_values = {name: repr(value) for name, value in params.items()}
    _play(player, draw_two_rounds(detector))
    for name, value in player.get_params(deep=False).items():
        same = value is params[name] and repr(value) == old_values[name]
        _require(same, f"an episode must leave the argument {name} unchanged, got {quote(value)}.")
    twin = clone(player)
    _require(type(twin) is kind, f"clone must return a {kind.__name__}, got a {type(twin).__name__}.")


def check_answers_with_a_detection(detector: Any) -> None:
    """``detect`` returns a ``Detection`` for all UAVs, whatever the seed."""
    player, windows = copy.deepcopy(detector), draw_two_rounds(detector)
    _play(player, windows)
    player.reset()
    _validate(player.detect(windows[0]), windows[0])


def check_same_seed_same_answer(detector: Any) -> None:
    """The same seed gives bitwise equal detections over an episode, also after another episode."""
    player, copied = copy.deepcopy(detector), copy.deepcopy(detector)
    first = _play(player, draw_two_rounds(detector))
    twin = _play(copied, draw_two_rounds(detector))
    _require_same(first, twin, "the same seed must give the same detection, got other")
    _play(player, [draw_window(detector, 20, 1, seed=7)], seed=_SEED + 1)
    repeated = _play(player, draw_two_rounds(detector))
    _require_same(first, repeated, "reset must clear the previous episode, got other")


def check_leaves_all_else_alone(detector: Any) -> None:
    """The global random generators of Python, NumPy and PyTorch (if imported) stay as they are."""
    player, window = copy.deepcopy(detector), draw_window(detector, miss_rate=0.1, destroyed=2, round=2)
    _play(player, [window])  # it may import a library
    random.random()  # so that a detector that seeds a generator is noticed
    np.random.rand()  # noqa: NPY002  # the global generator is what is checked
    if torch := sys.modules.get("torch"):
        torch.rand(1)
    old_states = _read_generators()
    _play(player, [window])  # its arrays are read-only
    new_states = _read_generators()
    changed = [name for name in old_states if old_states[name] != new_states[name]]
    _require(not changed, f"a detector must leave global generators alone, got a change of {', '.join(changed)}.")


def _read_generators() -> dict[str, Any]:
    """The states of the global generators of all imported libraries."""
    states: dict[str, Any] = {"numpy.random": repr(np.random.get_state()), "random": random.getstate()}  # noqa: NPY002  # only read
    if torch := sys.modules.get("torch"):
        states["torch"] = torch.get_rng_state().tolist()
    return states


def check_any_window(detector: Any) -> None:
    """``detect`` answers any swarm and missing samples, or raises an ``ArgumentError`` for fewer than 3 UAVs."""
    player, small = copy.deepcopy(detector), draw_window(detector, 3, 1)
    large, single = draw_window(detector, 60, 7), draw_window(detector, 16, 1)
    for window in (small, large, single, draw_gaps(detector), stop_uavs(small)):
        _play(player, [window])
    for uavs in (1, 2):
        with suppress(ArgumentError):
            _play(player, [pick_uavs(small, np.arange(uavs))])


def check_order_of_uavs(detector: Any) -> None:
    """Permuting the UAVs permutes the detection, exactly or by a permutation test on mean candidates and mean ranks."""
    window = draw_window(detector)
    order = np.random.default_rng(_SEED).permutation(window.uavs)  # the reverse order would keep pairs of neighbours
    inverse, shuffled = np.argsort(order), pick_uavs(window, order)

    def summarise(seed: int, shuffle: bool) -> Floats:
        """``(2, N)``: candidates and scores in the order of the window, in units of the largest score."""
        (answer,) = _play(copy.deepcopy(detector), [shuffled if shuffle else window], seed)
        values = np.stack([answer.candidates, answer.scores / max(float(np.abs(answer.scores).max()), 1e-12)])
        return values[:, inverse] if shuffle else values

    if np.allclose(summarise(_SEED, False), summarise(_SEED, True), rtol=1e-4, atol=1e-4):
        return
    samples = np.stack([summarise(seed, seed >= _EPISODES) for seed in range(2 * _EPISODES)])
    # Scores that differ by rounding errors only must share a rank.
    samples[:, 1] = rankdata(np.round(samples[:, 1], 4), axis=1) / window.uavs
    p = compare_samples(samples[:_EPISODES].reshape(_EPISODES, -1), samples[_EPISODES:].reshape(_EPISODES, -1))
    _require(p >= _LEVEL, f"permuting the UAVs must permute the detection, got another (p = {p:.4f}).")


def compare_samples(first: Floats, second: Floats) -> float:
    """p-value of a permutation test for equal means of two samples, ``(k, d)`` each."""
    pooled, rng = np.concatenate([first, second]), np.random.default_rng(0)
    orders = np.stack([np.arange(len(pooled)), *(rng.permutation(len(pooled)) for _ in range(_RELABELLINGS))])
    distance = ((np.where(orders < len(first), 1.0, -1.0) @ pooled) ** 2).sum(axis=1)
    return float((distance >= distance[0] * (1 - 1e-9) - 1e-9).mean())


def check_later_rounds(detector: Any) -> None:
    """A destroyed UAV is never a candidate in later rounds, whether a few or nearly all UAVs are destroyed."""
    windows = [draw_window(detector, 20, destroyed=losses, round=r) for r, losses in enumerate((0, 4, 17), start=1)]
    for seed in range(_SEED, _SEED + 3):
        _play(copy.deepcopy(detector), windows, seed)


def check_label_and_pickle(detector: Any) -> None:
    """Its label makes an equal detector; a pickled copy gives the same detections, also within an episode."""
    player, windows = copy.deepcopy(detector), draw_two_rounds(detector)
    pickled = pickle.loads(pickle.dumps(player))  # its own bytes, of no file
    first = _play(player, windows[:1])
    _require_same(first, _play(pickled, windows[:1]), "an unpickled detector must answer as before, got other")
    pickled = pickle.loads(pickle.dumps(player))
    expected, answers = ([_validate(copied.detect(windows[1]), windows[1])] for copied in (player, pickled))
    _require_same(expected, answers, "a detector that is pickled within an episode must continue it, got other")
    names = _list_arguments(detector)
    try:
        name, arguments = parse_label(label := detector_label(detector), {})
    except ArgumentError:
        return  # an argument is no literal, such as a policy
    twin: Any = make_detector(label) if name in DETECTORS else type(detector)(**arguments)
    different = [name for name in names if repr(getattr(twin, name)) != repr(getattr(detector, name))]
    _require(not different, f"the label {label} must make an equal detector, got other {', '.join(different)}.")


#: All checks in the order in which they run.
CHECKS: tuple[Callable[[Any], None], ...] = (
    check_constructor_only_stores,
    check_answers_with_a_detection,
    check_same_seed_same_answer,
    check_leaves_all_else_alone,
    check_any_window,
    check_order_of_uavs,
    check_later_rounds,
    check_label_and_pickle,
)
