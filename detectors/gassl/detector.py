"""GASSL, the graph attention self-supervised learning of §III, as a detector."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field

from detectors.base import Detector
from detectors.gassl.input_pooling import InputPooling, fit_input_pooling
from detectors.gassl.inputs import samples_of
from detectors.gassl.prediction_pooling import PredictionPooling, fit_prediction_pooling
from detectors.gassl.votes import RULES, choices, probabilities, top
from usnet_env.config import ArgumentError, Config, quote, unknown_name
from usnet_env.detection import Detection
from usnet_env.window import Window

__all__ = ["PRESETS", "Gassl"]

Floats = NDArray[np.float64]

#: pooling and vote rule of each preset: the best pair by measurement, and the paper's.
PRESETS = {"default": ("predictions", "mass"), "paper": ("inputs", "paper")}
POOLINGS = ("predictions", "inputs")

_LEAST_UAVS = 3  # a head and two followers


class _Arguments(Config):
    """The plain arguments, checked; settings of a pooling are checked by its own config."""

    preset: str
    pooling: str | None
    rule: str | None
    top_k: Annotated[int, Field(ge=1)]
    gate: bool
    gate_threshold: Annotated[float, Field(ge=0)]
    device: str
    memory: Annotated[int, Field(ge=1, le=1000)]


class Gassl(Detector):
    """Graph attention self-supervised learning: whom does every UAV's flight depend on? (the paper's Algorithm 1).

    Every UAV attends to the others so that a shared network, the IFSN, can predict its next velocity; the UAV that is
    attended to most is the head. Made for one cluster (P1); :meth:`detect_among` looks at a part of a swarm.

    Args:
        preset: ``"default"`` (prediction pooling, votes by mass) or ``"paper"`` (the paper's network and rule).
        pooling: ``"predictions"`` or ``"inputs"``; ``None``: the preset's. See
            :mod:`detectors.gassl.prediction_pooling` and :mod:`detectors.gassl.input_pooling`.
        rule: ``"paper"``, ``"exclude-self"``, ``"occlusion"`` or ``"mass"``; ``None``: the preset's. See
            :func:`detectors.gassl.votes.probabilities`.
        top_k: K, how many candidates are named.
        gate: name nobody where nobody seems to be followed; with prediction pooling only. By default the best guess is
            named in any case.
        gate_threshold: how much better than by its own history the second best of a candidate's followers must be
            predicted on held-out times, as the logarithm of the errors' ratio (a head has two followers or more).
        device: ``"cpu"``, ``"cuda"`` or ``"auto"`` (a GPU if there is one).
        memory: T_0.
        steps, times, learning_rate, weight_decay, input_noise: of training; ``None``: the pooling's default, see
            :class:`detectors.gassl.prediction_pooling.PredictionPooling` and
            :class:`detectors.gassl.input_pooling.InputPooling`.
        voters, units, blocks, ridge, floor: of prediction pooling.
        query_hidden, query, key, similarity_hidden, ifsn_hidden, ifsn_learning_rate: of input pooling.

    Raises:
        ArgumentError: from :meth:`reset` and :meth:`detect`: an argument is refused, the device is not there, or the
            window has fewer than 3 UAVs, no UAV that was seen, or no more than T_0 velocities.
    """

    def __init__(
        self,
        preset: str = "default",
        pooling: str | None = None,
        rule: str | None = None,
        top_k: int = 1,
        gate: bool = False,
        gate_threshold: float = 0.5,
        device: str = "cpu",
        memory: int = 4,
        steps: int | None = None,
        times: int | None = None,
        learning_rate: float | None = None,
        weight_decay: float | None = None,
        input_noise: float | None = None,
        voters: int | None = None,
        units: int | None = None,
        blocks: int | None = None,
        ridge: float | None = None,
        floor: float | None = None,
        query_hidden: int | None = None,
        query: int | None = None,
        key: int | None = None,
        similarity_hidden: tuple[int, int] | None = None,
        ifsn_hidden: tuple[int, ...] | None = None,
        ifsn_learning_rate: float | None = None,
    ) -> None:
        self.preset = preset
        self.pooling = pooling
        self.rule = rule
        self.top_k = top_k
        self.gate = gate
        self.gate_threshold = gate_threshold
        self.device = device
        self.memory = memory
        self.steps = steps
        self.times = times
        self.learning_rate = learning_rate
        self.weight_decay = weight_decay
        self.input_noise = input_noise
        self.voters = voters
        self.units = units
        self.blocks = blocks
        self.ridge = ridge
        self.floor = floor
        self.query_hidden = query_hidden
        self.query = query
        self.key = key
        self.similarity_hidden = similarity_hidden
        self.ifsn_hidden = ifsn_hidden
        self.ifsn_learning_rate = ifsn_learning_rate

    def settings(self) -> tuple[PredictionPooling | InputPooling, str]:
        """The settings of the pooling, and the vote rule; checks every argument.

        Raises:
            ArgumentError: an argument is refused, or belongs to the other pooling.
        """
        plain = _Arguments(**{name: getattr(self, name) for name in _Arguments.model_fields})
        if plain.preset not in PRESETS:
            raise unknown_name("preset", plain.preset, PRESETS)
        pooling = PRESETS[plain.preset][0] if plain.pooling is None else plain.pooling
        rule = PRESETS[plain.preset][1] if plain.rule is None else plain.rule
        if pooling not in POOLINGS:
            raise unknown_name("pooling", pooling, POOLINGS)
        if rule not in RULES:
            raise unknown_name("rule", rule, RULES)
        if plain.gate and pooling != "predictions":
            raise ArgumentError("gate must be False with pooling='inputs', whose fit has no held-out times, got True.")
        kinds: dict[str, type[PredictionPooling] | type[InputPooling]] = {
            "predictions": PredictionPooling,
            "inputs": InputPooling,
        }
        known = set(PredictionPooling.model_fields) | set(InputPooling.model_fields)
        given = {name: getattr(self, name) for name in sorted(known) if getattr(self, name) is not None}
        kind = kinds[pooling]
        for name, value in given.items():
            if name not in kind.model_fields:
                raise ArgumentError(f"{name} must be None with pooling={pooling!r}, got {quote(value)}.")
        return kind(**given), rule

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
            Candidates (``top_k`` of them; none if the gate closes), scores c_i, ``leader`` (whom each UAV chose among
            the others), attention alpha, and in ``extras``: ``choice`` ``(N,)``, with a UAV's own index where it
            attends to itself or its own history most; ``explained`` ``(N,)``, the share of the squared velocity that
            the fit explains (held out with prediction pooling, on the training times with input pooling). With input
            pooling ``attention_heads`` ``(T_0 + 1, N, N)``; with prediction pooling ``gain`` ``(N,)``, the held-out
            evidence that each UAV is followed (what the gate looks at), and ``followed`` (bool), whether the gate
            would open.
        """
        return self.detect_batch([window])[0]

    def detect_among(self, window: Window, members: NDArray[np.bool_]) -> Detection:
        """Look at a part of the swarm only: the others are taken as if they were not there.

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
        settings, rule = self.settings()
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
                found = self._fit(chosen, among, settings, rule, device, rng)
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
        """One or two UAVs hold no evidence: some of them are named at random."""
        candidates = np.zeros(window.uavs, bool)
        candidates[rng.permutation(index)[: self.top_k]] = not self.gate
        return Detection(candidates=candidates, scores=np.zeros(window.uavs), extras={"followed": False})

    def _fit(
        self,
        windows: list[Window],
        members: list[NDArray[np.intp]],
        settings: PredictionPooling | InputPooling,
        rule: Literal["paper", "exclude-self", "occlusion", "mass"] | str,
        device: torch.device,
        rng: np.random.Generator,
    ) -> list[Detection]:
        samples = samples_of(windows, members, self.memory, device)
        generator = torch.Generator(device).manual_seed(int(rng.integers(2**63)))
        whole: list[dict[str, Any]] = []
        if isinstance(settings, PredictionPooling):
            fit = fit_prediction_pooling(samples, settings, generator)
            attention = fit.attention.double()
            # What is lost without candidate j: -log(1 - alpha_ij), as alpha is the posterior of a mixture.
            rise = -torch.log1p(-attention.clamp(max=1.0 - 1e-12))
            second = fit.held_out_gain.sort(dim=1, descending=True).values[:, 1]
            for e in range(len(windows)):
                gain = second[e].double().cpu().numpy()
                followed = bool(gain[int(fit.winner[e])] >= self.gate_threshold)
                whole.append({"gain": gain, "followed": followed})
            explained = fit.explained
        else:
            inputs = fit_input_pooling(samples, settings, generator, occlude=rule == "occlusion")
            attention, rise, explained = inputs.attention.double(), inputs.rise.double(), inputs.explained
            whole = [{"attention_heads": heads.double().cpu().numpy()} for heads in inputs.attention_heads]
        return [
            self._answer(
                window,
                index,
                rule,
                attention[e].cpu().numpy(),
                rise[e].cpu().numpy(),
                {**whole[e], "explained": explained[e].double().cpu().numpy()},
                rng,
            )
            for e, (window, index) in enumerate(zip(windows, members, strict=True))
        ]

    def _answer(
        self,
        window: Window,
        index: NDArray[np.intp],
        rule: str,
        attention: Floats,
        rise: Floats,
        extras: dict[str, Any],
        rng: np.random.Generator,
    ) -> Detection:
        """Votes of the n UAVs looked at, written out for all N of the window."""
        uavs = window.uavs
        choice, own = choices(attention, False, rng), choices(attention, True, rng)
        c = probabilities(rule, attention, rise, choice, own)
        candidates, scores = np.zeros(uavs, bool), np.zeros(uavs)
        scores[index] = c
        if not self.gate or extras["followed"]:
            candidates[index[top(c, self.top_k, rng)]] = True
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
