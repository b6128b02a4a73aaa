"""The interface of all detectors, those of this package and those of plugins."""

from __future__ import annotations

from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from detectors.parameters import Parameters
from usnet_env.arrays import Mask
from usnet_env.config import optional_seed
from usnet_env.detection import Detection, Tags, fit_window
from usnet_env.window import Window


class Detector(Parameters):
    """Base class of detectors: :meth:`detect` takes a window and returns a detection.

    A subclass defines :meth:`detect`, and declares the arguments of its constructor as in
    :class:`detectors.parameters.Parameters`. A class without this base works as well if it has the methods ``reset``
    and ``detect``. The constructor stores its keyword arguments and does nothing else (scikit-learn's rule). State that
    is kept between the rounds of an episode is a ``cached_property``: :meth:`reset` clears it, and its first use makes
    it, also without a :meth:`reset`.

    Attributes:
        tags: what the detector needs and uses; :func:`usnet_env.plugins.list_detectors` shows it and
            :func:`detectors.checks.check_detector` chooses its windows by it.
    """

    tags: ClassVar[Tags] = Tags()
    _made_by_reset: ClassVar[str | None] = None  # the name of a cached property whose draws are the first of an episode

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

    def as_policy(self) -> DetectorPolicy:
        """Return this detector as a policy with Stable-Baselines3's ``predict`` method."""
        return DetectorPolicy(self)


class DetectorPolicy:
    """A detector with Stable-Baselines3's ``predict`` method, which takes an observation and returns an action.

    Args:
        detector: the detector to call. It is reset at the start of every episode.
        seed: seed of the generator that draws the ``reset`` seed of each episode.
    """

    def __init__(self, detector: Detector, seed: int | None = None) -> None:
        self.detector = detector
        self._seeds = np.random.default_rng(optional_seed("seed", seed))
        self._begun = False

    def predict(
        self,
        observation: Any,
        state: tuple[NDArray[Any], ...] | None = None,
        episode_start: Mask | None = None,
        deterministic: bool = False,
    ) -> tuple[NDArray[np.int8], tuple[NDArray[Any], ...] | None]:
        """Return the candidates for one observation, a mapping, as an action ``(N,)`` int8, and ``state`` unchanged.

        The first call and a true ``episode_start`` start an episode. ``deterministic`` is ignored: a detector draws
        from its own generator.
        """
        if not self._begun or (episode_start is not None and bool(np.any(episode_start))):
            self.detector.reset(int(self._seeds.integers(2**31)))
            self._begun = True
        detection = self.detector.detect(fit_window(self.detector, Window.from_observation(observation)))
        return detection.candidates.astype(np.int8), state
