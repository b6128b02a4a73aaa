"""The network that learns to play ``USNET/Probing-v1``, what it reads of windows, and how intruders fly at a UAV."""

from __future__ import annotations

import numpy as np
import torch
from paper import shared
from scipy.fft import irfft, rfft
from torch import Tensor, nn

from detectors.weights import read_arrays
from usnet_env.arrays import Floats, Observation
from usnet_env.envs.probing import ProbingArguments

WEIGHTS = shared.RESULTS / "probing_learners.safetensors"
STEPS, NEAR = 17, 5  # of a filter; lags that are compared as they are
SHIFTS = 2 * STEPS - 1
#: What the filters begin with: the steps of the sums, and by how many the UAV is before the others, of its velocity (0)
#: or its push (1).
FILTERS = [(0, scale, lag) for scale in (1, 2, 4, 8, 16) for lag in (-1, 0, 1)] + [(1, 1, 1), (1, 4, 1), (1, 4, 0)]


class ProbeNetwork(nn.Module):
    """Judges each UAV by how the others fly on average after it flew, and after it was pushed.

    Filters over the last steps of the velocity and of the push of a UAV make a course of it, others one of the mean
    velocity of the rest. What is known about a UAV are the correlations of these courses. The order of the UAVs doesn't
    matter, nor the orientation of space, and their number may change.

    Args:
        width: hidden units.
    """

    knows_head = False  #: whether it begins with a belief that was learned from labels

    def __init__(self, width: int = 48) -> None:
        super().__init__()
        own, rest = _make_filters()
        self.own, self.rest = nn.Parameter(own), nn.Parameter(rest)  # (F, 2, STEPS), (F, STEPS)
        known = 4 * len(own) + 4 * NEAR + 2
        self.look = nn.Sequential(nn.Linear(known, width), nn.ReLU(), nn.Linear(width, width), nn.ReLU())
        self.compare = nn.Sequential(nn.Linear(3 * width, width), nn.ReLU())
        self.name, self.test = nn.Linear(width, 1), nn.Sequential(nn.Linear(width + 3, 16), nn.ReLU(), nn.Linear(16, 1))
        self.weigh = nn.Sequential(nn.Linear(width + 3, 16), nn.ReLU(), nn.Linear(16, 3))
        for last in (self.name, self.test[-1], self.weigh[-1]):
            nn.init.zeros_(last.weight)
        steps = torch.arange(STEPS)
        apart = steps[:, None] - steps + STEPS - 1  # by how many steps an entry of the first filter is the later one
        self.register_buffer("apart", nn.functional.one_hot(apart, SHIFTS).float(), persistent=False)

    def forward(self, known: Tensor, passed: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Log-probabilities ``(B, N)`` of each UAV as the head and as the one to test; ``(B, 3)``: see below.

        Args:
            known: ``(B, N, C)``: for each UAV the covariances of :func:`measure` and two distances.
            passed: ``(B, 2)``, the samples so far, and their share of the full window.

        The last three numbers are how good it is to name a UAV and to test one, and the value of the game.
        """
        looked = self.look(self.correlate(known[..., :-2], passed[:, 0]))
        context = torch.cat([looked.mean(dim=1), looked.amax(dim=1)], dim=1)[:, None].expand(-1, looked.shape[1], -1)
        compared = self.compare(torch.cat([looked, context], dim=2))
        head = self.name(compared)[..., 0].log_softmax(dim=1)
        fixed = head.detach()  # what is done isn't learned at the belief's cost
        test = self.test(torch.cat([compared, known[..., -2:], fixed[..., None] / 3], dim=2))[..., 0]
        test = (test + fixed - 8 * known[..., -2]).log_softmax(dim=1)  # at first the near and probable ones
        sure = fixed.amax(dim=1)
        game = torch.stack([sure / 3, sure.exp(), passed[:, 1]], dim=1)
        return head, test, self.weigh(torch.cat([compared.mean(dim=1), game], dim=1))

    def correlate(self, known: Tensor, elapsed: Tensor) -> Tensor:
        """``(B, N, F)``: correlations of courses, their evidence and sizes, the samples, and the number of UAVs."""
        mixed, own, rest = known.split([2 * SHIFTS, 4 * SHIFTS, SHIFTS], dim=2)
        sizes = own.unflatten(2, (2, 2, SHIFTS))[..., STEPS - 1].diagonal(dim1=2, dim2=3)
        variance = sizes * rest[..., STEPS - 1 : STEPS]
        dot = mixed @ torch.einsum("fcl,fm,lmt->ctf", self.own, self.rest, self.apart).flatten(0, 1)
        own = own @ torch.einsum("fcl,fdm,lmt->cdtf", self.own, self.own, self.apart).flatten(0, 2)
        rest = rest @ torch.einsum("fl,fm,lmt->tf", self.rest, self.rest, self.apart)
        own, rest = own.clamp(min=0) + 1e-4, rest.clamp(min=0) + 1e-4
        seen = elapsed.clamp(min=1)[:, None, None]
        correlation = (dot / (own * rest).sqrt()).clamp(-0.999, 0.999)
        evidence = -correlation.sign() * seen * torch.log1p(-correlation.square()) / 10
        lags = mixed.unflatten(2, (2, SHIFTS)) / (variance[..., None] + 1e-4).sqrt() * seen[..., None].sqrt() / 3
        after, before = lags[..., STEPS - 1 :][..., :NEAR], lags.flip(-1)[..., STEPS - 1 :][..., :NEAR]
        lags = torch.cat([after + before, after - before], dim=2).flatten(2)
        game = [torch.log(seen / 10), torch.full_like(seen, np.log(known.shape[1] / 10))]
        game = [part.expand(-1, known.shape[1], 1) for part in game]
        parts = correlation * seen.sqrt() / 3, evidence, torch.log(own) / 3, torch.log(rest) / 3, lags, *game
        return torch.cat(parts, dim=2)


def _make_filters() -> tuple[Tensor, Tensor]:
    """The filters of a UAV ``(F, 2, STEPS)`` and of the rest ``(F, STEPS)`` at the start; their last entry is now."""
    own, rest = torch.zeros(len(FILTERS), 2, STEPS), torch.zeros(len(FILTERS), STEPS)
    for number, (kind, scale, lag) in enumerate(FILTERS):
        for part, delay in ((own[number, kind], max(lag, 0)), (rest[number], max(-lag, 0))):
            part[max(STEPS - delay - scale, 0) : STEPS - delay] = scale**-0.5
    return own, rest


def measure(seen: Observation, arguments: ProbingArguments) -> tuple[Tensor, Tensor]:
    """What the network reads of the windows of B games, see :meth:`ProbeNetwork.forward`.

    These are covariances of the velocity of each UAV, of the turn that the intruders' push gives it on average, and of
    the mean velocity of the others that are not pushed, up to ``STEPS`` - 1 steps apart.
    """
    away = seen["position"][:, :-1, :, None] - seen["intruders"][:, :-1, None]  # (B, T_ob, N, K, 3)
    distance = np.sqrt(np.einsum("...c,...c->...", away, away))[..., None] + 1e-6
    push = arguments.push * (np.maximum(1 - distance / arguments.reach, 0) * away / distance).sum(axis=3)
    push *= (np.arange(push.shape[1]) < seen["elapsed"])[:, :, None, None]
    size = np.sqrt(np.einsum("...c,...c->...", push, push))[..., None]
    turn = push * np.where(size <= 1, 2 / 3, (1 - 1 / (3 * np.maximum(size, 1) ** 2)) / np.maximum(size, 1))
    alone = size == 0
    sums, counts = (part.sum(axis=2, keepdims=True) - part for part in (alone * seen["velocity"], alone.astype(int)))
    rest = sums / np.maximum(counts, 1)
    waves = rfft(np.stack([seen["velocity"], turn, rest]).astype(np.float32), turn.shape[1] + STEPS, axis=2)
    pairs = [(0, 2), (1, 2), (0, 0), (0, 1), (1, 0), (1, 1), (2, 2)]
    products = [(waves[one] * waves[other].conj()).sum(axis=-1) for one, other in pairs]
    known = np.stack([irfft(product, turn.shape[1] + STEPS, axis=1) for product in products])
    known = known[:, :, range(1 - STEPS, STEPS)].transpose(1, 3, 0, 2) / np.maximum(seen["elapsed"], 1)[..., None, None]
    passed = np.concatenate([seen["elapsed"], seen["elapsed"] / arguments.observation_steps], axis=1)
    uavs, intruders = place(seen)
    near = np.linalg.norm(uavs[:, :, None] - intruders[:, None], axis=3).min(axis=2)
    far = np.linalg.norm(uavs - uavs.mean(axis=1, keepdims=True), axis=2)
    distances = np.stack([near, far], axis=2) / (2 * arguments.reach)
    read = np.concatenate([known.reshape(*known.shape[:2], -1), distances], axis=2, dtype=np.float32)
    return torch.from_numpy(read), torch.from_numpy(passed)


def place(seen: Observation) -> tuple[Floats, Floats]:
    """Where the UAVs ``(B, N, 3)`` and the intruders ``(B, K, 3)`` of B games are, in metres."""
    games, elapsed = np.arange(len(seen["elapsed"])), seen["elapsed"][:, 0].astype(int)
    return seen["position"][games, elapsed], seen["intruders"][games, elapsed]


def fly_at(seen: Observation, gain: Floats, arguments: ProbingArguments) -> Floats:
    """The action ``steer`` ``(B, K, 3)`` that flies each intruder to the UAV with the greatest gain ``(B, K, N)``.

    As those of a ``Prober``, intruders fly to the outer side of the UAV, each to another one.
    """
    uavs, intruders = place(seen)
    games, gain, goals = np.arange(len(uavs)), gain.copy(), np.empty_like(intruders)
    for k in range(intruders.shape[1]):
        chosen = gain[:, k].argmax(axis=1)
        gain[games, :, chosen] = -np.inf
        outward = uavs[games, chosen] - uavs.mean(axis=1)
        outward /= np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-6)
        goals[:, k] = uavs[games, chosen] + arguments.reach / 3 * outward
    steer = (goals - intruders) / (arguments.top_speed * arguments.sample_every * arguments.look_every)
    return (steer / np.maximum(np.linalg.norm(steer, axis=2, keepdims=True), 1 + 1e-6)).astype(np.float32)


def fly_nearest(seen: Observation, belief: Floats, arguments: ProbingArguments) -> Floats:
    """The action ``steer`` that flies at the nearest of the UAVs that are more probable than 1/N."""
    uavs, intruders = place(seen)
    distance = np.linalg.norm(uavs[:, None] - intruders[:, :, None], axis=3)
    return fly_at(seen, np.where(belief[:, None] >= 1 / belief.shape[1], 0, -1e6) - distance, arguments)


def read_belief() -> ProbeNetwork:
    """The network that learned from labels."""
    network = ProbeNetwork()
    network.load_state_dict({name: torch.from_numpy(part) for name, part in read_arrays(WEIGHTS).items()})
    return network
