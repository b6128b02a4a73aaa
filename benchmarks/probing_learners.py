"""USNET/Probing-v1: what a network learns from windows, by labels of the head or by rewards.

    export OMP_NUM_THREADS=1
    python benchmarks/probing_learners.py --labels 200    # learns a belief, and writes its weights
    python benchmarks/probing_learners.py --belief --rows benchmarks/results/probing.csv.gz    # plays it in all cells
    python benchmarks/probing_learners.py                 # learns by rewards, with the seeds that the rows lack
    python benchmarks/probing_learners.py --draw          # learns nothing: the tables of the rows

The network is the same. From labels it learns the head in the games of all cells, in which UAVs are tested at random or
by the present belief. From rewards it learns in one cell, by PPO, to wait, to fly at a UAV, or to name one. It starts
from random weights, and in the first part of the training must wait until the window is full; or from the belief that
was learned from labels, and at first does what the prober ``nearest`` does with it.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
import pandas as pd
import probing
import torch
from paper import shared
from pivot import CellFormatter, pivot, size
from probing_network import WEIGHTS, ProbeNetwork, fly_at, fly_nearest, measure, read_belief
from scipy.stats import trim_mean
from torch import Tensor, nn

from detectors.weights import write_weights
from usnet_env.arrays import Floats, Indices, Observation
from usnet_env.envs.probing import ProbingArguments

ROWS = shared.RESULTS / "probing_learners.csv.gz"
CELL, SCORED, FRESH = "the same, noise 1 m", 200, 2**40  # where PPO learns; games of a score; the seed of their first
#: The game that PPO learns, and others, by what differs.
OTHERS: dict[str, dict[str, Any]] = {
    CELL: {},
    "19 followers": {"followers": 19},
    "29 followers": {"followers": 29},
    "intruder at 2 m a step": {"top_speed": 2.0},
    "intruder at 8 m a step": {"top_speed": 8.0},
    "noise 2.5 m": {"position_noise": 2.5},
}
CONFIDENCE = 0.9  # from which the belief is named
Act = Callable[[Observation], tuple[dict[str, Any], Floats]]  # the action of B games, and the belief in each name
PLAYED, LOOKS, UPDATES = 256, 13, 15  # PPO: games, looks of a rollout, updates
STARTS = {"random": (2e-3, 0.01, 0.6), "labels": (5e-4, 0.0, 0.0)}  # rate, weight of the entropy, part that must wait
GAMES, BATCH = 64, 256  # games that are drawn at once for labels; looks of a step of the optimizer
PASSES = {"labels": 3, "rewards": 6}  # how often each look is learned


def make_games(cell: str, games: int, mode: str, **changed: Any) -> Any:
    """A batch of games of a cell, with some arguments changed."""
    how = {"observe": ("position", "velocity"), "reveal_truth": True, "autoreset_mode": mode}
    return gym.make_vec("USNET/Probing-v1", games, **how, **(probing.ALL | probing.CELLS[cell] | changed)).unwrapped


def draw_looks(network: ProbeNetwork, envs: Any, seed: int) -> tuple[Tensor, Tensor, Tensor]:
    """Play B games until their windows are full; return what is read of all looks but the first, and the heads.

    In a third of the games UAVs are tested at random, in a third by the belief, and in the rest by either at times.
    """
    arguments, rng = envs.games[0].arguments, np.random.default_rng(seed)
    seen, truth = envs.reset(seed=seed)
    count, uavs = seen["position"].shape[0], seen["position"].shape[2]
    chance, parts = rng.choice([0.0, 0.5, 1.0], count), []
    gain = rng.random((count, arguments.intruders, uavs))
    read = measure(seen, arguments)
    for _ in range(-(-arguments.observation_steps // arguments.look_every)):
        with torch.no_grad():
            belief = network(*read)[0].exp().numpy()
        gain = np.where(rng.random((count, 1, 1)) < 0.3, rng.random(gain.shape), gain)
        steer = fly_nearest(seen, belief, arguments)
        by_chance = rng.random(count) < chance
        steer[by_chance] = fly_at(seen, gain, arguments)[by_chance]
        seen, *_ = envs.step({"steer": steer, "name": np.full(count, uavs)})
        read = measure(seen, arguments)
        parts.append(read)
    known, passed = map(torch.cat, zip(*parts, strict=True))
    return known, passed, torch.from_numpy(truth["head"].argmax(axis=1)).repeat(len(parts))


def learn_belief(batches: int, seed: int = 0, cells: Any = tuple(probing.CELLS)) -> ProbeNetwork:
    """Learn the heads of the games of some cells, in turn."""
    network, rng = ProbeNetwork(), np.random.default_rng(seed)
    optimizer = torch.optim.Adam(network.parameters(), lr=2e-3)
    decay = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, 3 * batches)
    envs, losses = {cell: make_games(cell, GAMES, "Disabled") for cell in cells}, dict[str, float]()
    for batch in range(batches):
        cell = list(cells)[rng.integers(len(cells))]
        known, passed, heads = draw_looks(network, envs[cell], int(rng.integers(2**31)))
        for rows in torch.cat([torch.randperm(len(heads)) for _ in range(PASSES["labels"])]).split(BATCH):
            loss = nn.functional.nll_loss(network(known[rows], passed[rows])[0], heads[rows])
            optimizer.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(network.parameters(), 1.0)
            optimizer.step()
            losses[cell] = 0.9 * losses.get(cell, loss.item()) + 0.1 * loss.item()
        decay.step()
        if batch % 20 == 19:
            print(batch, f"{time.process_time():.0f} s", *(f"{v:.2f}" for c, v in sorted(losses.items())), flush=True)
    return network


def weigh_actions(network: ProbeNetwork, read: tuple[Tensor, Tensor], patient: bool = False) -> tuple[Tensor, Tensor]:
    """Log-probabilities ``(B, 2 N + 1)`` to name a UAV, to test one, and to stay, and values ``(B,)``.

    A full window must be answered. At first one look in thirty or so is, or as the network that knows the head does.
    """
    head, test, game = network(*read)
    kinds = torch.stack([game[:, 0] - 3, game[:, 1], torch.zeros(len(game))], dim=1)
    if network.knows_head:  # at first as `nearest`
        belief = head.detach()
        test = (test - belief - 100 * (belief < -math.log(belief.shape[1]))).log_softmax(dim=1)
        odds = belief.amax(dim=1).exp().logit(1e-6) - math.log(CONFIDENCE / (1 - CONFIDENCE))
        kinds = torch.stack([game[:, 0] + 2 * odds.clamp(-4, 4), game[:, 1], torch.full_like(odds, -3)], dim=1)
    full = read[1][:, 1] >= 1
    kinds[:, 0] -= 1e3 * patient
    kinds[full] = torch.tensor([0.0, -1e3, -1e3])
    kinds = kinds.log_softmax(dim=1)
    return torch.cat([head + kinds[:, :1], test + kinds[:, 1:2], kinds[:, 2:]], dim=1), game[:, 2]


def to_action(seen: Observation, chosen: Indices, arguments: ProbingArguments) -> dict[str, Any]:
    """The action of the game for actions of :func:`weigh_actions`, ``(B,)``."""
    uavs = seen["position"].shape[2]
    gain = np.zeros((len(chosen), arguments.intruders, uavs))
    tests = (chosen >= uavs) & (chosen < 2 * uavs)
    gain[tests, :, chosen[tests] - uavs] = 1
    return {"steer": tests[:, None, None] * fly_at(seen, gain, arguments), "name": np.minimum(chosen, uavs)}


@torch.no_grad()
def play_looks(
    network: ProbeNetwork, envs: Any, seen: Observation, patient: bool
) -> tuple[dict[str, Tensor], Observation]:
    """Play ``LOOKS`` looks of all games; every entry is ``(LOOKS, B, ...)``."""
    arguments, looks = envs.games[0].arguments, []
    for _ in range(LOOKS):
        read = measure(seen, arguments)
        chances, value = weigh_actions(network, read, patient)
        action = torch.multinomial(chances.exp(), 1)[:, 0]
        seen, reward, over, _, _ = envs.step(to_action(seen, action.numpy(), arguments))
        paid = {"reward": torch.from_numpy(reward).float(), "over": torch.from_numpy(over).float()}
        log = chances.gather(1, action[:, None])[:, 0]
        looks.append({"known": read[0], "passed": read[1], "action": action, "log": log, "value": value, **paid})
    played = {name: torch.stack([look[name] for look in looks]) for name in looks[0]}
    after, last = weigh_actions(network, measure(seen, arguments), patient)[1], 0.0
    advantage = torch.zeros_like(played["value"])
    for t in reversed(range(LOOKS)):
        goes_on = 1 - played["over"][t]
        last = played["reward"][t] + goes_on * (after + 0.95 * last) - played["value"][t]
        advantage[t], after = last, played["value"][t]
    return played | {"advantage": advantage}, seen


def learn_rewards(cell: str, start: str, seed: int, updates: int) -> Iterator[tuple[int, ProbeNetwork]]:
    """PPO: yield the decisions so far and the network, at first and after every third update."""
    network = read_belief() if start == "labels" else ProbeNetwork()
    network.knows_head, (rate, entropy, waiting) = start == "labels", STARTS[start]
    envs = make_games(cell, PLAYED, "SameStep")
    seen, _ = envs.reset(seed=seed)
    optimizer = torch.optim.Adam(network.parameters(), lr=rate, eps=1e-5)
    yield 0, network
    for update in range(updates):
        patient = update < waiting * updates
        played, seen = play_looks(network, envs, seen, patient)
        flat = {name: part.flatten(0, 1) for name, part in played.items()}
        target = flat["advantage"] + flat["value"]
        flat["advantage"] = (flat["advantage"] - flat["advantage"].mean()) / (flat["advantage"].std() + 1e-8)
        optimizer.param_groups[0]["lr"] = rate * max(1 - update / updates, 0.05)
        for rows in torch.cat([torch.randperm(len(target)) for _ in range(PASSES["rewards"])]).split(BATCH):
            chances, value = weigh_actions(network, (flat["known"][rows], flat["passed"][rows]), patient)
            ratio = (chances.gather(1, flat["action"][rows, None])[:, 0] - flat["log"][rows]).exp()
            advantage = flat["advantage"][rows]
            gain = torch.minimum(ratio * advantage, ratio.clamp(0.8, 1.2) * advantage).mean()
            spread = -(chances.exp() * chances).sum(dim=1).mean()
            loss = 0.5 * (value - target[rows]).square().mean() - gain - entropy * spread
            optimizer.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(network.parameters(), 0.5)
            optimizer.step()
        if update % 3 == 2:
            yield (update + 1) * PLAYED * LOOKS, network


@torch.no_grad()
def play_games(envs: Any, seed: Any, act: Act) -> pd.DataFrame:
    """Play a game each: whether the name is right, the samples until it, its belief, and the reward."""
    seen, _ = envs.reset(seed=seed)
    left = np.ones(envs.num_envs, bool)
    played = {name: np.zeros(len(left)) for name in ("right", "elapsed", "belief", "reward")}
    while left.any():  # a game that is over begins again, but what follows doesn't count
        action, belief = act(seen)
        played["elapsed"][left], played["belief"][left] = seen["elapsed"][left, 0], belief[left]
        seen, reward, over, _, _ = envs.step(action)
        played["reward"][left] += reward[left]
        played["right"][left & over] = reward[left & over] == 0  # a name itself costs neither time nor moves
        left &= ~over
    return pd.DataFrame(played)


def follow(network: ProbeNetwork, envs: Any) -> Act:
    """The most probable action of each game."""
    arguments = envs.games[0].arguments

    def act(seen: Observation) -> tuple[dict[str, Any], Floats]:
        chances = weigh_actions(network, measure(seen, arguments))[0]
        return to_action(seen, chances.argmax(dim=1).numpy(), arguments), chances.amax(dim=1).exp().numpy()

    return act


def probe(network: ProbeNetwork, envs: Any, flies: bool) -> Act:
    """As a scripted prober, with the belief of the network."""
    arguments = envs.games[0].arguments

    def act(seen: Observation) -> tuple[dict[str, Any], Floats]:
        belief = network(*measure(seen, arguments))[0].exp().numpy()
        named = (belief.max(axis=1) >= CONFIDENCE) | (seen["elapsed"][:, 0] >= arguments.observation_steps)
        name = np.where(named, belief.argmax(axis=1), belief.shape[1])
        return {"steer": flies * fly_nearest(seen, belief, arguments), "name": name}, belief.max(axis=1)

    return act


def play(game: shared.Game) -> list[dict[str, Any]]:
    """Play a cell with the belief that was learned from labels, in the same swarms as all probers."""
    envs, seeds = make_games(game["cell"], SCORED, "SameStep"), [*map(probing.draw_seed, range(SCORED))]
    played = play_games(envs, seeds, probe(read_belief(), envs, game["target"] != "none"))
    early = (played.elapsed < envs.config.observation_steps).astype(int)
    return [game | row for row in played.assign(early=early, episode=played.index).to_dict("records")]


def train(game: shared.Game, updates: int) -> list[dict[str, Any]]:
    """Learn by rewards; score the policy on the way, and at the end also in games that it did not learn."""
    rows, envs = [], {name: make_games(CELL, SCORED, "SameStep", **changed) for name, changed in OTHERS.items()}

    def score(name: str, decisions: int, network: ProbeNetwork) -> None:
        found = play_games(envs[name], FRESH, follow(network, envs[name])).mean()
        rows.append(game | {"decisions": decisions, "game": name, **found[["right", "elapsed", "reward"]]})

    with shared.isolate_torch(game["seed"]):
        for point in learn_rewards(CELL, game["start"], game["seed"], updates):
            score(CELL, *point)
            print(rows[-1], flush=True)
    for name in list(envs)[1:]:
        score(name, *point)
    return rows


def middle(metric: str, digits: int = 2) -> CellFormatter:
    """The interquartile mean over seeds, with its 95 % interval from 2,000 bootstrap samples of them."""

    def format_cell(rows: pd.DataFrame) -> str:
        if not len(rows):
            return "–"
        values = rows[metric].to_numpy()
        draws = np.random.default_rng(0).choice(values, (2000, len(values)))
        low, high = np.quantile(trim_mean(draws, 0.25, axis=1), [0.025, 0.975])
        return f"{trim_mean(values, 0.25):.{digits}f} ({low:.{digits}f}–{high:.{digits}f})"

    return format_cell


def report(rows: pd.DataFrame) -> str:
    """The curves, and the last policies in games that they did not learn."""
    columns = {"seeds": size, "names the head": middle("right"), "steps until it names": middle("elapsed", 1)}
    columns["reward"] = middle("reward")
    rows = rows.sort_values(["start", "decisions"], ascending=[False, True], kind="stable")
    rows = rows.assign(start=rows.start.map({"random": "random weights", "labels": "the belief"}))
    curve, others = ({"from": "start", name: name} for name in ("decisions", "game"))
    ours = rows.game == CELL
    return f"{pivot(rows[ours], curve, columns)}\n\n{pivot(rows[~ours], others, columns)}"


def main(argv: list[str] | None = None) -> None:
    parser = shared.make_parser(__doc__, ROWS)
    parser.add_argument("--labels", type=int, help="batches of games whose labels are learned")
    parser.add_argument("--belief", action="store_true", help="play the belief that was learned from labels")
    parser.add_argument("--trainings", type=int, default=10, help="seeds of PPO")
    options = parser.parse_args(argv)
    if options.labels:
        with shared.isolate_torch(0):
            network = learn_belief(options.labels)
        arrays = {name: part.numpy() for name, part in network.state_dict().items()}
        write_weights(WEIGHTS, arrays, {"batches": options.labels, "games": GAMES, "passes": PASSES["labels"]}, {})
    elif options.belief:
        pairs = [(cell, target) for cell in probing.CELLS for target in ("none", "nearest")]
        pairs = [(cell, target) for cell, target in pairs if "K =" not in cell or target not in probing.STILL]
        games = [{"detector": "learned", "cell": cell, "target": target} for cell, target in pairs]
        shared.run_missing(options, games, play)
    else:
        games = [{"start": start, "seed": seed} for start in STARTS for seed in range(options.trainings)]
        print(report(shared.run_missing(options, games, partial(train, updates=UPDATES))))


if __name__ == "__main__":
    main()
