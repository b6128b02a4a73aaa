"""Find and create detectors by name.

A name is one of three things: a name registered with :func:`register_detector` in this process; the name of an entry
point in the group ``usnet.detectors``; or ``module:Class``. Python literals may follow in brackets as arguments:
``lagged-regression(clusters=5)``.
"""

from __future__ import annotations

import sys
from importlib import import_module
from operator import attrgetter
from typing import Any, Protocol, runtime_checkable

from usnet_env.config import ArgumentError, quote, unknown_name
from usnet_env.detection import Detection
from usnet_env.parts import Registry, are_equal, check_call, check_factory, format_label, named_parameters, parse_label
from usnet_env.window import Window


@runtime_checkable
class DetectorLike(Protocol):
    """The methods that a detector needs; no base class is required."""

    def reset(self, seed: int | None = None) -> None:
        """Start an episode; ``seed`` seeds the detector's random numbers."""

    def detect(self, window: Window) -> Detection:
        """Return the answer for one window."""


#: All detectors by name: classes, and functions that return a detector.
DETECTORS = Registry("detector", "detector", "usnet.detectors", __name__, check_factory, classes=True)

#: Register a class, or a function that returns a detector; see :meth:`usnet_env.parts.Registry.register`.
register_detector = DETECTORS.register


def make_detector(name: str, /, **arguments: Any) -> DetectorLike:
    """Create a detector.

    Args:
        name: a registered name or ``module:Class``, with or without arguments: ``"lagged-regression(clusters=5)"``.
        arguments: further arguments of the detector's constructor.

    Raises:
        ArgumentError: there is no such detector, it can't be imported, or its constructor doesn't take the arguments.
        MissingExtraError: it needs a package that is not installed.

    >>> make_detector("lagged-regression(clusters=5)", lags=3).get_params()
    {'clusters': 5, 'lags': 3, 'ridge': 0.001, 'squares': True}
    """
    base_name, all_arguments = parse_label(name, arguments)
    subject = f"detector {base_name!r}"
    module, colon, attribute = base_name.partition(":")
    if colon:
        factory = DETECTORS.load(base_name, lambda: attrgetter(attribute)(import_module(module)))
    elif base_name in DETECTORS:
        factory = DETECTORS[base_name]
    else:
        raise unknown_name("detector", base_name, [*DETECTORS, "module:Class"])
    check_call(subject, factory, all_arguments)
    detector = factory(**all_arguments)
    if not isinstance(detector, DetectorLike):
        raise ArgumentError(f"{subject} must have the methods detect(window) and reset(seed), got {quote(detector)}.")
    return detector


def find_detector(detector: Any) -> DetectorLike:
    """The detector of a name, or the object itself; one without the methods ``detect`` and ``reset`` is refused."""
    player = make_detector(detector) if isinstance(detector, str) else detector
    if isinstance(player, type) or not isinstance(player, DetectorLike):
        hint = " (detectors.policy_detector.PolicyDetector makes one of a policy)" * hasattr(player, "predict")
        hint = f" ({player.__name__}() makes one)" if isinstance(player, type) else hint
        expected = "a name, or an object with detect(window) and reset(seed)"
        raise ArgumentError(f"detector must be {expected}, got {quote(detector)}{hint}.")
    return player


def detector_label(detector: Any) -> str:
    """Return the label of a detector in tables, such as ``lagged-regression(clusters=5)``.

    Args:
        detector: a name as :func:`make_detector` takes it, or a detector. The label of an object is the registered
            name of its class, or else the name of the class, with all arguments that differ from their defaults.

    >>> detector_label(make_detector("lagged-regression", clusters=5))
    'lagged-regression(clusters=5)'
    """
    if isinstance(detector, str):
        return format_label(*parse_label(detector, {}))
    detector_class = type(detector)
    changed = {
        name: getattr(detector, name)
        for name, parameter in named_parameters(detector_class).items()
        if hasattr(detector, name) and not are_equal(getattr(detector, name), parameter.default)
    }
    points = DETECTORS.entry_points()
    loaded = {name: getattr(sys.modules.get(point.module), point.attr, None) for name, point in points.items()}
    names = (name for name, factory in {**DETECTORS.registered, **loaded}.items() if factory is detector_class)
    return format_label(next(names, detector_class.__name__), changed)
