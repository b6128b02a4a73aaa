"""Checks of the constructor, of scikit-learn's parameter methods, and of pickling."""

from __future__ import annotations

import inspect
import pickle
from collections.abc import Mapping
from typing import Any
from unittest import SkipTest

from sklearn.base import clone

from detectors.checks.harness import (
    calling,
    copy_detector,
    play_windows,
    request_detection,
    require,
    require_same,
)
from detectors.checks.windows import draw_two_rounds, draw_window
from usnet_env.config import quote


def check_constructor_only_stores(detector: Any) -> None:
    """The constructor stores its keyword arguments unchanged under their names, and stores nothing else."""
    kind = type(detector)
    given = {name: object() for name in _list_argument_names(detector)}  # no constructor can interpret these
    with calling("its constructor"):
        made = kind(**given)
    stored = dict(vars(made))
    for name, value in given.items():
        require(
            stored.pop(name, None) is value,
            f"the constructor must store {name} unchanged as self.{name}; reset is the place to check it.",
        )
    require(not stored, f"the constructor must store its arguments only, also got {', '.join(sorted(stored))}.")


def check_parameters_and_clone(detector: Any) -> None:
    """``get_params``, ``set_params`` and ``clone`` match the constructor; an episode changes no argument."""
    names = _list_argument_names(detector)
    own = copy_detector(detector)
    with calling("get_params"):
        params: Mapping[str, Any] = own.get_params(deep=False)
    wanted = ", ".join(names) or "no argument"
    require(sorted(params) == names, f"get_params must return {wanted}, got {quote(sorted(params))}.")
    before = {name: (value, repr(value)) for name, value in params.items()}
    with calling("set_params"):
        returned = own.set_params(**params)
    require(returned is own, "set_params must return the detector.")
    play_windows(own, draw_two_rounds(detector))
    for name, (value, text) in before.items():
        now = own.get_params(deep=False)[name]
        same = now is value and repr(now) == text
        require(same, f"an episode must leave the argument {name} unchanged, got {quote(now)}.")
    with calling("its clone"):
        twin = clone(own)
    require(type(twin) is type(own), f"clone must return a {type(own).__name__}, got a {type(twin).__name__}.")
    require(sorted(twin.get_params(deep=False)) == names, "clone must return a detector with the same arguments.")


def check_pickling(detector: Any) -> None:
    """Pickling preserves the detector, also within an episode; worker processes receive it in this way."""
    own = copy_detector(detector)
    there = _pickle_and_unpickle(own)
    require(type(there) is type(own), f"unpickling must return a {type(own).__name__}, got a {type(there).__name__}.")
    (here,), (same,) = (play_windows(one, [draw_window(detector)]) for one in (own, there))
    require_same(here, same, "an unpickled detector must give the same detection, got another")
    there = _pickle_and_unpickle(own)
    here, same = (request_detection(one, draw_two_rounds(detector)[1]) for one in (own, there))
    require_same(here, same, "a detector that is pickled within an episode must continue it, got another")


def _pickle_and_unpickle(detector: Any) -> Any:
    """Pickle and unpickle; the bytes never come from a file."""
    with calling("its pickling"):
        return pickle.loads(pickle.dumps(detector))


def _list_argument_names(detector: Any) -> list[str]:
    """The constructor's argument names in alphabetical order; skips detectors without scikit-learn's methods."""
    if not callable(getattr(detector, "get_params", None)):
        raise SkipTest("it has no method get_params, so scikit-learn's rules do not apply.")
    parameters = list(inspect.signature(type(detector)).parameters.values())
    loose = [p.name for p in parameters if p.kind in (p.VAR_POSITIONAL, p.VAR_KEYWORD, p.POSITIONAL_ONLY)]
    require(not loose, f"the constructor must name its arguments one by one, got {', '.join(loose)}.")
    return sorted(parameter.name for parameter in parameters)
