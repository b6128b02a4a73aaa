"""What trains networks to fly observers: PPO, with or without a critic that knows the true state, and QMIX."""

from __future__ import annotations

import copy

import numpy as np
import torch
from patrols import FLIGHTS, Patrol, Search
from torch.distributions import Categorical

ROUNDS = 16  # of a rollout
PER_HIT = 2.0  # rounds, the reward in training for a head that is hit
DISCOUNT = 0.99
QMIX_RATE, QMIX_DISCOUNT, PACE = 1e-2, 0.9, 0.02  # the last is that of the slow copy
MEMORY, SAMPLE, UPDATES = 400, 4, 2  # rounds of all games that QMIX remembers, of a sample; samples a round


def make_network(inputs: int, outputs: int, width: int = 64) -> torch.nn.Module:
    """A network with two hidden layers."""
    layers = [torch.nn.Linear(inputs, width), torch.nn.Tanh(), torch.nn.Linear(width, width), torch.nn.Tanh()]
    return torch.nn.Sequential(*layers, torch.nn.Linear(width, outputs))


def follow_policy(actor: torch.nn.Module, rng: np.random.Generator) -> Patrol:
    """The patrol that draws each flight from what an actor says."""

    @torch.no_grad()
    def fly(search: Search) -> np.ndarray:
        shares = torch.softmax(actor(torch.from_numpy(search.look())), dim=-1).numpy()
        return FLIGHTS[(rng.random((*shares.shape[:2], 1)) > shares.cumsum(axis=2)).sum(axis=2).clip(0, 8)]

    return fly


def fly_greedily(actor: torch.nn.Module) -> Patrol:
    """The patrol that takes the flight of the highest value."""

    @torch.no_grad()
    def fly(search: Search) -> np.ndarray:
        return FLIGHTS[actor(torch.from_numpy(search.look())).argmax(dim=-1).numpy()]

    return fly


def _pay(search: Search, action: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Fly: the rewards of training and whether games go on, both ``(B,)``."""
    reward, over, metrics = search.step(FLIGHTS[action.numpy()])
    return torch.from_numpy((reward + PER_HIT * metrics["hits"]) / 5).float(), torch.from_numpy(~over).float()


def train_by_ppo(search: Search, actor: torch.nn.Module, central: bool, decisions: int, rate: float = 1e-3) -> None:
    """PPO with the same weights for all observers; a ``central`` critic gets the true state, too (MAPPO; else IPPO)."""

    def know(look: np.ndarray) -> torch.Tensor:
        """What the critic gets."""
        flat = look.reshape(*look.shape[:2], -1)
        if not central:
            return torch.from_numpy(flat)
        state = np.repeat(search.state()[:, None], search.count, axis=1)
        return torch.from_numpy(np.concatenate([flat, state], axis=2))

    critic = make_network(know(search.look()).shape[2], 1)
    weights = [*actor.parameters(), *critic.parameters()]
    optimizer = torch.optim.Adam(weights, lr=rate, eps=1e-5)
    total = max(1, decisions // (search.num_envs * ROUNDS * search.count))
    for number in range(total):
        optimizer.param_groups[0]["lr"] = rate * (1 - number / total)
        steps = []
        for _ in range(ROUNDS):
            look = torch.from_numpy(search.look())
            critic_input = know(look.numpy())
            with torch.no_grad():
                policy, value = Categorical(logits=actor(look)), critic(critic_input)[..., 0]
            action = policy.sample()
            pair = [part[:, None].expand(value.shape) for part in _pay(search, action)]
            steps.append([look, critic_input, action, policy.log_prob(action), value, *pair])
        look, critic_input, action, old_log_prob, value, reward, continues = (
            torch.stack(part) for part in zip(*steps, strict=True)
        )
        advantage, last = torch.zeros_like(value), torch.zeros_like(value[0])
        with torch.no_grad():
            after = critic(know(search.look()))[..., 0]
        for t in reversed(range(ROUNDS)):
            last = reward[t] + DISCOUNT * continues[t] * after - value[t] + DISCOUNT * 0.95 * continues[t] * last
            advantage[t], after = last, value[t]
        target, advantage = advantage + value, (advantage - advantage.mean()) / (advantage.std() + 1e-8)
        flat = [part.flatten(0, 2) for part in (look, critic_input, action, old_log_prob, target, advantage)]
        for _ in range(4):
            for rows in torch.randperm(len(flat[0])).split(768):
                look, critic_input, action, old_log_prob, target, gain = (part[rows] for part in flat)
                policy = Categorical(logits=actor(look))
                ratio = (policy.log_prob(action) - old_log_prob).exp()
                loss = 0.5 * (critic(critic_input)[..., 0] - target).square().mean() - 0.01 * policy.entropy().mean()
                loss = loss - torch.minimum(ratio * gain, ratio.clamp(0.8, 1.2) * gain).mean()
                optimizer.zero_grad()
                loss.backward()
                torch.nn.utils.clip_grad_norm_(weights, 0.5)
                optimizer.step()
        search.redraw()


class Mixer(torch.nn.Module):
    """The value of what all observers choose, which grows with that of each of them (QMIX, Rashid et al. 2018)."""

    def __init__(self, observers: int, state: int, width: int = 32) -> None:
        super().__init__()
        self.first, self.second = torch.nn.Linear(state, observers * width), torch.nn.Linear(state, width)
        self.bias, self.own = torch.nn.Linear(state, width), make_network(state, 1, width)

    def forward(self, values: torch.Tensor, state: torch.Tensor) -> torch.Tensor:
        """The value ``(n,)`` of the values ``(n, K)`` in a state ``(n, S)``."""
        first = self.first(state).abs().unflatten(1, (values.shape[1], -1))
        hidden = torch.nn.functional.elu(torch.einsum("nk,nkw->nw", values, first) + self.bias(state))
        return (hidden * self.second(state).abs()).sum(dim=1) + self.own(state)[:, 0]


def train_by_qmix(search: Search, actor: torch.nn.Module, decisions: int) -> None:
    """QMIX with double Q-learning from remembered rounds; the network's outputs are the values of the flights."""
    mixer = Mixer(search.count, search.state().shape[1])
    online = torch.nn.ModuleList([actor, mixer])
    slow = copy.deepcopy(online)
    optimizer = torch.optim.Adam(online.parameters(), lr=QMIX_RATE, eps=1e-5)
    total, memory = max(1, decisions // (search.num_envs * search.count)), list[list[torch.Tensor]]()

    def learn() -> None:
        """A step of the optimizer, and a small one of the slow copy."""
        moments = torch.randint(len(memory), (SAMPLE,)).tolist()
        sample = [torch.cat(part) for part in zip(*(memory[moment] for moment in moments), strict=True)]
        look, state, action, reward, continues, next_look, next_state = sample
        with torch.no_grad():
            best = actor(next_look).argmax(dim=-1, keepdim=True)
            after = slow[1](slow[0](next_look).gather(2, best)[..., 0], next_state)
        value = mixer(actor(look).gather(2, action[..., None])[..., 0], state)
        loss = torch.nn.functional.smooth_l1_loss(value, reward + QMIX_DISCOUNT * continues * after)
        optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(online.parameters(), 10.0)
        optimizer.step()
        with torch.no_grad():
            for part, new in zip(slow.parameters(), online.parameters(), strict=True):
                part.lerp_(new, PACE)

    look, state = (torch.from_numpy(part) for part in (search.look(), search.state()))
    for number in range(total):
        optimizer.param_groups[0]["lr"] = QMIX_RATE * (1 - number / total)
        with torch.no_grad():
            action = actor(look).argmax(dim=-1)
        is_random = torch.rand(action.shape) < max(0.05, 1 - 3 * number / total)
        action = torch.where(is_random, torch.randint(len(FLIGHTS), action.shape), action)
        paid = _pay(search, action)
        after = [torch.from_numpy(part) for part in (search.look(), search.state())]
        memory[number % MEMORY : number % MEMORY + 1] = [[look, state, action, *paid, *after]]
        look, state = after
        if (number + 1) % ROUNDS == 0:
            search.redraw()
            look, state = (torch.from_numpy(part) for part in (search.look(), search.state()))
        for _ in range(UPDATES):
            learn()
