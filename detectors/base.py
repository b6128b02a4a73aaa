"""The interface of all detectors, those of this package and those of plugins."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, cached_property, wraps
from typing import Any, ClassVar

import numpy as np
from threadpoolctl import ThreadpoolController

from detectors.parameters import Parameters
from usnet_env.config import ArgumentError, optional_seed
from usnet_env.detection import Detection, Tags
from usnet_env.window import Window


@cache
def _find_libraries(detector: str) -> ThreadpoolController:
    """The libraries with threads of their own that are loaded when a detector of this name first answers."""
    return ThreadpoolController()


def _guard(detect: Callable[..., Detection]) -> Callable[..., Detection]:
    """Check the arguments and the size of the window, and let libraries compute in one thread.

    Several threads wait longer for each other than a small product takes.
    """

    @wraps(detect)
    def guarded(self: Any, window: Window) -> Detection:
        self.check_arguments()
        most = self.tags.most_uavs
        if most is not None and window.uavs > most:
            raise ArgumentError(f"window must hold at most {most} UAVs for this detector, got {window.uavs}.")
        with _find_libraries(type(self).__qualname__).limit(limits=1):
            return detect(self, window)

    return guarded


class Detector(Parameters):
    """Base class of detectors: :meth:`detect` takes a window and returns a detection.

    A subclass defines :meth:`detect`, and declares the arguments of its constructor as in
    :class:`detectors.parameters.Parameters`. A class without this base works as well if it has the methods ``reset``
    and ``detect``. The constructor stores its keyword arguments and does nothing else (scikit-learn's rule). State that
    is kept between the rounds of an episode is a ``cached_property``: :meth:`reset` clears it, and its first use makes
    it, also without a :meth:`reset`. Before :meth:`detect` runs, the arguments are checked, and the number of UAVs by
    the tags; while it runs, BLAS and OpenMP, so PyTorch too, have one thread.

    Attributes:
        tags: what the detector needs and uses; ``usnet list detectors`` shows it and
            :func:`detectors.checks.check_detector` chooses its windows by it.

    Example:
        >>> class Fastest(Detector):
        ...     def detect(self, window):
        ...         speed = np.linalg.norm(window.velocity, axis=2).mean(axis=0)
        ...         return Detection(speed == speed.max(), scores=speed)
        >>> position = np.arange(5.0)[:, None, None] * np.array([1.0, 3.0, 2.0])[:, None] * np.ones(3)
        >>> Fastest().detect(Window(position, np.diff(position, axis=0), np.ones((5, 3)), np.ones(3))).candidates
        array([False,  True, False])
    """

    tags: ClassVar[Tags] = Tags()
    _made_by_reset: ClassVar[str | None] = None  # the name of a cached property whose draws are the first of an episode

    def __init_subclass__(cls, **named: Any) -> None:
        super().__init_subclass__(**named)
        if "detect" in vars(cls):
            cls.detect = _guard(cls.detect)  # type: ignore[method-assign]  # mypy allows no new method

    @cached_property
    def rng(self) -> np.random.Generator:
        """The generator of the episode; with a seed from the operating system if :meth:`reset` was not called."""
        return np.random.default_rng()

    def reset(self, seed: int | None = None) -> None:
        """Start an episode: check the arguments, clear the state of the previous episode, and create :attr:`rng`.

        The ``seed`` of ``self.rng`` is never that of the environment; ``None`` takes one from the operating system. A
        refused argument of the constructor, or a seed below 0, raises an ``ArgumentError``.
        """
        self.check_arguments()
        for name in list(vars(self)):
            if isinstance(getattr(type(self), name, None), cached_property):
                del vars(self)[name]
        self.rng = np.random.default_rng(optional_seed("seed", seed))
        if self._made_by_reset is not None:
            getattr(self, self._made_by_reset)

    def detect(self, window: Window) -> Detection:
        """Name the candidates of one round.

        Args:
            window: the observation of one round. Its arrays are read-only.

        Returns:
            A detection with candidates ``(N,)`` and scores ``(N,)``; a destroyed UAV is never a candidate.

        Raises:
            ArgumentError: an argument is refused, or the window has more UAVs or fewer velocities than :attr:`tags`
                allow, or fewer UAVs than a given number of clusters.
        """
        raise NotImplementedError(f"{type(self).__name__} must define detect(window) -> Detection.")
