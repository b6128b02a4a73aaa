"""The detector ``neural-granger``: one additive network for each candidate head of a single cluster."""

from __future__ import annotations

from functools import partial
from typing import Annotated, Literal

import numpy as np
import torch
from pydantic import Field

from detectors.base import Detector
from detectors.neural_granger.training import build_samples, fit_networks
from detectors.parameters import Count, Lags
from detectors.series.designs import check_steps
from detectors.series.votes import choose_heads, name_at_random, scatter_to_swarm, select_top, shows_evidence
from usnet_env.config import Positive
from usnet_env.detection import Detection, Tags
from usnet_env.window import Window

NonNegative = Annotated[float, Field(ge=0)]


class NeuralGranger(Detector):
    """Neural Granger causality: the head is the UAV whose past predicts the other UAVs better than their own past does.

    For each candidate a network predicts the next velocity of all other UAVs from the candidate's past. The network
    that is best, compared with the null model, wins; the null model is a ridge regression on the UAV's own past.
    Then the winner's network predicts each UAV i from the past of each other UAV j, and i attends to j in proportion to
    the likelihood of its flight; to itself by the likelihood of the null model. The score of a UAV is the attention
    that it receives. Made for one cluster (P1). The idea is that of Tank, Covert, Foti, Shojaie and Fox, "Neural
    Granger causality", IEEE Transactions on Pattern Analysis and Machine Intelligence 44(8), 2022.

    Args:
        top_k: the number of candidates.
        gate: whether the answer is empty unless at least two UAVs have a gain of ``gate_threshold`` from the best
            candidate: the logarithm of the null model's error divided by the network's error, on held-out times.
        gate_threshold: see ``gate``.
        device: ``"cpu"``, ``"cuda"`` or ``"auto"`` (a GPU if there is one).
        memory: T_0.
        steps, times, voters: training steps; random times and random UAVs that each network must predict in a step.
        units: tanh units for each coordinate of the candidate's past.
        learning_rate, weight_decay: of AdamW, with a cosine schedule; biases and gains do not decay.
        input_noise: standard deviation of the noise on a candidate's velocities, as a fraction of the root mean
            square error of its null model (so that the noise stays small for smooth flight).
        blocks: contiguous blocks of times that are held out, a fifth of all times, with gaps of T_0 on both sides.
        ridge: penalty of the null model.
        floor: squared error, in (metres per step)², that is added to all errors before their logarithm is taken.
    """

    tags = Tags(needs=("torch",), most_uavs=10_000, least_steps=5, needs_unit_speed=True)

    top_k: Count = 1
    gate: bool = False
    gate_threshold: NonNegative = 0.5
    device: Literal["cpu", "cuda", "auto"] = "cpu"
    memory: Lags = 4
    steps: Count = 200
    times: Count = 64
    voters: Annotated[int, Field(ge=2, le=100_000)] = 24
    units: Annotated[int, Field(ge=1, le=1000)] = 6
    learning_rate: Positive = 3e-2
    weight_decay: NonNegative = 0.3
    input_noise: NonNegative = 0.2
    blocks: Annotated[int, Field(ge=1, le=100)] = 4
    ridge: Positive = 1.0
    floor: Annotated[float, Field(ge=1e-12)] = 1e-3

    def detect(self, window: Window) -> Detection:
        """Train on one window and name the candidates.

        Returns:
            Candidates (``top_k`` of them; none if the gate is closed), scores (the attention that a UAV receives from
            the others, divided by the number n of living UAVs), ``leader`` (the other UAV to which each UAV attends
            most), attention alpha, and in ``extras``: ``choice`` ``(N,)``, as ``leader``, but a UAV's own index if it
            attends most to its own past; ``gain`` ``(N,)``, which the gate compares with its threshold; ``followed``
            (bool), whether it reaches it. With fewer than 3 living UAVs, or where no velocity was seen, ``top_k``
            living UAVs are named at random (none with the gate) and all scores are 0.
        """
        living = np.flatnonzero(window.alive)
        check_steps(window, self.memory)
        if not shows_evidence(window, living):
            candidates = name_at_random(living, 0 if self.gate else self.top_k, window.uavs, self.rng)
            return Detection(candidates, np.zeros(window.uavs), extras={"followed": False})
        automatic = "cuda" if torch.cuda.is_available() else "cpu"
        device = torch.device(automatic if self.device == "auto" else self.device)
        generator = torch.Generator(device).manual_seed(int(self.rng.integers(2**63)))
        fit = fit_networks(build_samples(window, living, self.memory, device), self, generator)
        second_gain = fit.held_out_gain.sort(dim=0, descending=True).values[1]
        attention, gain = (part.double().cpu().numpy() for part in (fit.attention, second_gain))
        choice, other_choice = choose_heads(attention, False, self.rng), choose_heads(attention, True, self.rng)
        c = np.where(np.eye(len(living), dtype=bool), 0.0, attention).sum(axis=0) / len(living)
        followed = bool(gain[fit.winner] >= self.gate_threshold)
        is_named = np.zeros(len(living), bool)
        if not self.gate or followed:
            is_named[select_top(c, self.top_k, self.rng)] = True
        scatter = partial(scatter_to_swarm, members=living, uavs=window.uavs)
        extras = {"choice": scatter(living[choice], fill=-1), "gain": scatter(gain), "followed": followed}
        leader, weights = scatter(living[other_choice], fill=-1), scatter(attention, pairs=True)
        return Detection(scatter(is_named), scatter(c), leader=leader, attention=weights, extras=extras)
