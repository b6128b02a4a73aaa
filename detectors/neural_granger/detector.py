"""Neural Granger causality with one additive network for each candidate head, as a detector for one cluster."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field

from detectors.base import Detector
from detectors.neural_granger.inputs import samples_of
from detectors.neural_granger.per_candidate import PerCandidate, fit_per_candidate
from usnet_env.config import ArgumentError, Config, quote
from usnet_env.detection import Detection
from usnet_env.window import Window

__all__ = ["NeuralGranger"]

Floats = NDArray[np.float64]

_LEAST_UAVS = 3  # a head and two followers


class _Arguments(Config):
    """The arguments that :class:`PerCandidate` does not check."""

    top_k: Annotated[int, Field(ge=1)]
    gate: bool
    gate_threshold: Annotated[float, Field(ge=0)]
    device: str
    memory: Annotated[int, Field(ge=1, le=1000)]


class NeuralGranger(Detector):
    """Which UAV's past predicts the others beyond their own past? One additive network for each candidate head.

    Neural Granger causality (Tank, Covert, Foti, Shojaie and Fox, 2022): for each candidate a network predicts the
    next velocity of all UAVs from the candidate's past, and is compared on held-out times with a ridge regression on
    the UAV's own past. UAV i attends to the candidates in proportion to their likelihoods (the posterior of a mixture),
    its own past being one of them; a candidate's score is the attention that it receives. The method grew out of
    GASSL (see :mod:`detectors.gassl`), from which it keeps the self-supervision and the votes; it pools predictions
    where GASSL pools inputs. Made for one cluster (P1); :meth:`detect_among` looks at a part of a swarm.

    Args:
        top_k: the number of candidates.
        gate: whether the answer is empty where no UAV seems to be followed. Without it the best guess is named.
        gate_threshold: how much better than by its own past the second best of a candidate's followers must be
            predicted on held-out times, as the logarithm of the errors' ratio (a head has two followers or more).
        device: ``"cpu"``, ``"cuda"`` or ``"auto"`` (a GPU if there is one).
        memory: T_0.
        steps, times, voters, units, learning_rate, weight_decay, input_noise, blocks, ridge, floor: of training; see
            :class:`detectors.neural_granger.per_candidate.PerCandidate`. ``None``: its default.

    Raises:
        ArgumentError: from :meth:`reset` and :meth:`detect`: an argument is refused, the device is not there, or the
            window has fewer than 3 UAVs, no UAV that was seen, or no more than T_0 velocities.
    """

    side_by_side: ClassVar[bool] = True

    def __init__(
        self,
        top_k: int = 1,
        gate: bool = False,
        gate_threshold: float = 0.5,
        device: str = "cpu",
        memory: int = 4,
        steps: int | None = None,
        times: int | None = None,
        voters: int | None = None,
        units: int | None = None,
        learning_rate: float | None = None,
        weight_decay: float | None = None,
        input_noise: float | None = None,
        blocks: int | None = None,
        ridge: float | None = None,
        floor: float | None = None,
    ) -> None:
        self.top_k = top_k
        self.gate = gate
        self.gate_threshold = gate_threshold
        self.device = device
        self.memory = memory
        self.steps = steps
        self.times = times
        self.voters = voters
        self.units = units
        self.learning_rate = learning_rate
        self.weight_decay = weight_decay
        self.input_noise = input_noise
        self.blocks = blocks
        self.ridge = ridge
        self.floor = floor

    def settings(self) -> PerCandidate:
        """The settings of training; checks every argument.

        Raises:
            ArgumentError: an argument is refused.
        """
        _Arguments(**{name: getattr(self, name) for name in _Arguments.model_fields})
        names = PerCandidate.model_fields
        return PerCandidate(**{name: getattr(self, name) for name in names if getattr(self, name) is not None})

    def _device(self) -> torch.device:
        if self.device == "auto":
            return torch.device("cuda" if torch.cuda.is_available() else "cpu")
        if self.device not in ("cpu", "cuda"):
            raise ArgumentError(f"device must be 'cpu', 'cuda' or 'auto', got {quote(self.device)}.")
        if self.device == "cuda" and not torch.cuda.is_available():
            raise ArgumentError("device must be one that is there ('cpu' or 'auto'), got 'cuda' without a GPU.")
        return torch.device(self.device)

    def reset(self, seed: int | None = None) -> None:
        """Start an episode.

        Raises:
            ArgumentError: an argument of the constructor is refused.
        """
        self.settings()
        self._device()
        super().reset(seed)

    def detect(self, window: Window) -> Detection:
        """Train on one window and name the candidates.

        Returns:
            Candidates (``top_k`` of them; none if the gate closes), scores (the attention that a UAV receives, divided
            by n), ``leader`` (the other UAV that each UAV attends to most), attention alpha, and in ``extras``:
            ``choice`` ``(N,)``, with a UAV's own index where it attends to its own past most; ``explained`` ``(N,)``,
            the share of the squared velocity that the fit explains on held-out times; ``gain`` ``(N,)``, the held-out
            evidence that each UAV is followed (what the gate looks at); ``followed`` (bool), whether the gate opens.
        """
        return self.detect_batch([window])[0]

    def detect_among(self, window: Window, members: NDArray[np.bool_]) -> Detection:
        """Look at a part of the swarm only; the other UAVs are taken as absent.

        Args:
            window: the whole swarm's.
            members: ``(N,)`` bool.
        """
        mask = np.asarray(members)
        if mask.shape != (window.uavs,) or mask.dtype != bool:
            raise ArgumentError(f"members must be {window.uavs} booleans, got {quote(members)}.")
        part = Window(window.position, window.velocity, window.seen, window.alive & mask, window.round)
        return self.detect(part)

    def detect_batch(self, windows: Sequence[Window]) -> list[Detection]:
        """Train on several windows side by side: much faster for small swarms than one after another.

        Windows with equal T_ob and equally many living UAVs share a batch. The draws of a batch come from one
        generator, so an answer depends on what it is batched with.
        """
        settings = self.settings()
        device = self._device()
        rng = getattr(self, "rng", None) or np.random.default_rng()
        groups: dict[tuple[int, int], list[int]] = {}
        members = []
        for number, window in enumerate(windows):
            index = self._members(window)
            members.append(index)
            groups.setdefault((len(index), window.observation_steps), []).append(number)
        answers: dict[int, Detection] = {}
        for (count, _), numbers in groups.items():
            chosen = [windows[number] for number in numbers]
            among = [members[number] for number in numbers]
            if count < _LEAST_UAVS:
                found = [self._too_few(window, index, rng) for window, index in zip(chosen, among, strict=True)]
            else:
                found = self._fit(chosen, among, settings, device, rng)
            answers.update(zip(numbers, found, strict=True))
        return [answers[number] for number in range(len(windows))]

    def _members(self, window: Window) -> NDArray[np.intp]:
        """Indices of the UAVs that can be looked at."""
        if window.uavs < _LEAST_UAVS:
            raise ArgumentError(f"window must hold at least {_LEAST_UAVS} UAVs, got {window.uavs}.")
        if window.observation_steps <= self.memory:
            raise ArgumentError(
                f"window must hold more than memory = {self.memory} velocities, got {window.observation_steps}."
            )
        if not window.velocity_seen.any():
            raise ArgumentError("window must show at least one UAV that lives, got one in which all are masked.")
        return np.flatnonzero(window.alive)

    def _too_few(self, window: Window, index: NDArray[np.intp], rng: np.random.Generator) -> Detection:
        """One or two UAVs hold no evidence: one of them is named at random, decision (x)."""
        candidates = np.zeros(window.uavs, bool)
        candidates[rng.permutation(index)[: self.top_k]] = not self.gate
        return Detection(candidates=candidates, scores=np.zeros(window.uavs), extras={"followed": False})

    def _fit(
        self,
        windows: list[Window],
        members: list[NDArray[np.intp]],
        settings: PerCandidate,
        device: torch.device,
        rng: np.random.Generator,
    ) -> list[Detection]:
        samples = samples_of(windows, members, self.memory, device)
        generator = torch.Generator(device).manual_seed(int(rng.integers(2**63)))
        fit = fit_per_candidate(samples, settings, generator)
        attention = fit.attention.double()
        second = fit.held_out_gain.sort(dim=1, descending=True).values[:, 1]
        whole: list[dict[str, Any]] = []
        for e in range(len(windows)):
            gain = second[e].double().cpu().numpy()
            followed = bool(gain[int(fit.winner[e])] >= self.gate_threshold)
            explained = fit.explained[e].double().cpu().numpy()
            whole.append({"gain": gain, "followed": followed, "explained": explained})
        return [
            self._answer(
                window,
                index,
                attention[e].cpu().numpy(),
                whole[e],
                rng,
            )
            for e, (window, index) in enumerate(zip(windows, members, strict=True))
        ]

    def _answer(
        self,
        window: Window,
        index: NDArray[np.intp],
        attention: Floats,
        extras: dict[str, Any],
        rng: np.random.Generator,
    ) -> Detection:
        """Votes of the n UAVs looked at, written out for all N of the window."""
        uavs = window.uavs
        choice, own = _choose(attention, False, rng), _choose(attention, True, rng)
        c = attention.copy()
        np.fill_diagonal(c, 0.0)
        c = c.sum(axis=0) / len(attention)
        candidates, scores = np.zeros(uavs, bool), np.zeros(uavs)
        scores[index] = c
        if not self.gate or extras["followed"]:
            candidates[index[np.lexsort((rng.random(len(c)), -c))[: self.top_k]]] = True
        leader, chosen = np.full(uavs, -1, np.int64), np.full(uavs, -1, np.int64)
        leader[index], chosen[index] = index[own], index[choice]
        spread = {
            name: _spread(value, index, uavs) if isinstance(value, np.ndarray) else value
            for name, value in extras.items()
        }
        return Detection(
            candidates=candidates,
            scores=scores,
            leader=leader,
            attention=_spread(attention, index, uavs),
            extras={"choice": chosen, **spread},
        )


def _spread(values: Floats, index: NDArray[np.intp], uavs: int) -> Floats:
    """``(n,)`` or ``(..., n, n)`` written out for all N UAVs, 0 elsewhere."""
    if values.ndim == 1:
        wide = np.zeros(uavs)
        wide[index] = values
        return wide
    wide = np.zeros((*values.shape[:-2], uavs, uavs))
    wide[..., index[:, None], index] = values
    return wide


def _choose(attention: Floats, exclude_self: bool, rng: np.random.Generator) -> NDArray[np.int64]:
    """The UAV that each UAV attends to most, ``(n,)``; ties are broken at random."""
    weight = attention.copy()
    if exclude_self:
        np.fill_diagonal(weight, -np.inf)
    ties = weight == weight.max(axis=1, keepdims=True)
    return np.where(ties, rng.random(weight.shape), -1.0).argmax(axis=1).astype(np.int64)
