"""Speed and memory of the simulator and of detectors, as ratios within one run.

    OMP_NUM_THREADS=1 python benchmarks/speed.py                        # all parts but peers
    OMP_NUM_THREADS=1 python benchmarks/speed.py --parts field scaling  # these parts; the others stay in the file
    OMP_NUM_THREADS=1 python benchmarks/speed.py --parts peers          # needs vmas, mpe2 and jaxmarl

The speed of a shared machine drifts, so contestants take turns, each turn gives one ratio, and the median counts. The
result is benchmarks/results/speed.json.
"""

from __future__ import annotations

import importlib
import json
import os
import subprocess
import sys
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from itertools import cycle
from pathlib import Path
from time import process_time
from timeit import timeit
from typing import Any

import gymnasium as gym
import numpy as np
from paper.shared import FOLLOW, RESULTS, ROOT, make_parser

import usnet_env  # noqa: F401  registers the environments
from usnet_env import Window, make_detector
from usnet_env.files import write_text
from usnet_env.plugins import DETECTORS
from usnet_env.provenance import machine, versions
from usnet_env.swarm import SwarmConfig, advance, register_formation, start
from usnet_env.swarm.follow import FIELD_MODELS
from usnet_env.swarm.formation import Roles

GAME = "USNET/MultiCluster-v0"
EPISODES, UAVS = 256, 82
GAMES = 64  # in a batch
BATCHES = ("SingleCluster-Tiny-v0", "SingleCluster-Small-v0", "MultiCluster-v0", "MultiCluster-Small-v0", "Field-v1")
SEVERAL = ("usnet_observers_v0", "usnet_evasion_v0")
SMALL_GAME: dict[str, Any] = {"clusters": 3, "uavs": 12, "observation_steps": 20}
SIZES = [100, 300, 1000, 3000, 10_000]
REFERENCE = "lagged-correlation"
TIMED = ("lagged-regression", "granger", "factions", "net-lag-regression", "reader")
LARGE = (("reader", 82), ("reader", 2000))
FEWER_STEPS = {
    "gassl": "gassl(steps=10)",
    "mc-gassl": "mc-gassl(gassl={'steps': 10})",
    "neural-granger": "neural-granger(steps=20)",
}
Play = tuple[int, Callable[[], object]]  # a function that plays, and the decisions of a call
# Not getrusage: a child begins with the peak of the process that started it.
MEMORY = """
import numpy as np, gymnasium as gym, usnet_env
envs = gym.make_vec("USNET/MultiCluster-v0", num_envs=1000)
envs.reset(seed=0)
for _ in range(3):
    envs.step(np.random.default_rng(0).random((1000, 82)) < 0.05)
lines = open("/proc/self/status").read().splitlines()
print(1024 * next(int(line.split()[1]) for line in lines if line.startswith("VmHWM")))
"""
# It answers a window for each line that it reads, and writes the seconds of the answer.
PLAYER = """
import sys, time
import gymnasium as gym, usnet_env
name, uavs = sys.argv[1], int(sys.argv[2])
env = gym.make("USNET/MultiCluster-v0", uavs=uavs)
window = usnet_env.Window.from_observation(env.reset(seed=0)[0])
detector = usnet_env.make_detector(name)
def answer():
    detector.reset(0)
    detector.detect(window)
answer()
for _ in sys.stdin:
    begin = time.perf_counter()
    answer()
    print(time.perf_counter() - begin, flush=True)
"""


def take_turns(turns: int, *contestants: Callable[[], object]) -> np.ndarray:
    """CPU seconds ``(turns, contestants)`` of contestants that take turns, after one warm-up each."""
    for contestant in contestants:
        contestant()
    return np.array(
        [[timeit(contestant, timer=process_time, number=1) for contestant in contestants] for _ in range(turns)]
    )


def describe(title: str, ratios: np.ndarray, **values: object) -> dict[str, object]:
    """What a ratio is of, its median, and that of each turn."""
    return {"what": title, **values, "ratio": float(np.median(ratios)), "ratios": ratios.tolist()}


def measure_stepping(turns: int, **arguments: Any) -> dict[str, object]:
    """A batch of swarms flies one round; NumPy draws as many float32 normals as that takes."""
    config = SwarmConfig(uavs=UAVS, **arguments)
    rngs = [np.random.default_rng(seed) for seed in range(EPISODES)]
    state = start(config, rngs)
    normals = config.steps * 3 * (UAVS + config.clusters)  # a followers' noise for all, the heads' own motion
    buffer, rng = np.empty(normals, np.float32), np.random.default_rng(0)

    def draw() -> None:
        for _ in range(EPISODES):
            rng.standard_normal(out=buffer, dtype=np.float32)

    seconds = take_turns(turns, lambda: advance(config, state, rngs), draw)
    rate = EPISODES * UAVS * config.steps / float(np.median(seconds[:, 0]))
    title = "rate of stepping over rate of drawing the same normals"
    return describe(title, seconds[:, 1] / seconds[:, 0], uav_steps_per_second=rate)


def measure_scaling(follow: str, turns: int) -> dict[str, object]:
    """One cluster of N UAVs flies one round; the sizes take turns.

    The density doesn't depend on N: 10,000 UAVs fill the arena of 1000 m x 1000 m x 100 m.
    """

    def place_uavs(rng: np.random.Generator, roles: Roles) -> np.ndarray:
        side = 1000.0 * np.sqrt(len(roles.root) / SIZES[-1])
        return rng.uniform(0.0, (side, side, 100.0), (len(roles.root), 3))

    register_formation("spread", place_uavs, replace=True)
    arguments: dict[str, Any] = {"clusters": 1, "memory": 12, "observation_steps": 20, "mobility": "straight"}
    configs = [SwarmConfig(follow=follow, formation="spread", uavs=uavs, **arguments) for uavs in SIZES]
    rngs = [np.random.default_rng(0)]
    times = take_turns(turns, *(partial(advance, config, start(config, rngs), rngs) for config in configs))
    seconds = np.median(times, axis=0) / [uavs * configs[0].steps for uavs in SIZES]
    title = "seconds of a UAV-step against N, one cluster at a fixed density"
    return {"what": title, "uavs": SIZES, "seconds_per_uav_step": seconds.tolist()}


def measure_memory(_: int) -> dict[str, object]:
    """Peak resident memory of a process that plays 1,000 swarms of N=82 at once."""
    output = subprocess.run([sys.executable, "-c", MEMORY], check=True, capture_output=True, text=True, cwd=ROOT).stdout
    return {"what": "peak resident bytes, 1,000 swarms of 82 UAVs", "bytes": int(output)}


def time_detectors(turns: int) -> dict[str, object]:
    """The same 20 windows (f1, N = 82) for each detector, and for the fastest baseline."""
    env = gym.make(GAME)
    windows = [Window.from_observation(env.reset(seed=seed)[0]) for seed in range(20)]

    def make_answer(name: str) -> Callable[[], object]:
        detector = make_detector(name)
        detector.reset(0)
        return lambda: [detector.detect(window) for window in windows]

    times = take_turns(turns, *map(make_answer, (REFERENCE, *TIMED)))
    title = f"seconds of a window (f1, N = 82) over those of {REFERENCE}"
    return {
        name: describe(title, seconds / times[:, 0], seconds=float(np.median(seconds)) / len(windows))
        for name, seconds in zip(TIMED, times.T[1:], strict=True)
    }


def compare_threads(name: str, uavs: int, turns: int) -> dict[str, object]:
    """A detector's seconds with threads as they come over those with one thread, alone and beside two busy loops."""
    unset = {key: value for key, value in os.environ.items() if not key.endswith("_NUM_THREADS")}
    command, result = [sys.executable, "-c", PLAYER, name, str(uavs)], dict[str, object]()
    pipes: dict[str, Any] = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True, "cwd": ROOT}
    with ExitStack() as stack:
        environments = (unset, unset | {"OMP_NUM_THREADS": "1"})
        players = [stack.enter_context(subprocess.Popen(command, env=env, **pipes)) for env in environments]

        def ask(player: subprocess.Popen[str]) -> float:
            print(file=player.stdin, flush=True)
            return float(player.stdout.readline())

        for load, loops in (("alone", 0), ("beside two busy loops", 2)):
            busy = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(loops)]
            try:
                seconds = np.array([[ask(player) for player in players] for _ in range(turns)])
            finally:
                for loop in busy:
                    loop.kill()
                    loop.wait()
            title = f"seconds with threads unset over those with one thread, {load}"
            result[load] = describe(title, seconds[:, 0] / seconds[:, 1], seconds=float(np.median(seconds[:, 1])))
        for player in players:
            player.stdin.close()
    return result


def race(title: str, turns: int, fast: Play, slow: Play) -> dict[str, object]:
    """The speed of two ways to play."""
    times = take_turns(turns, fast[1], slow[1])
    rate = fast[0] / float(np.median(times[:, 0]))
    return describe(title, (times[:, 1] / slow[0]) / (times[:, 0] / fast[0]), decisions_per_second=rate)


def play_one(name: str) -> Play:
    """Ten rounds of a single environment, in which no UAV is named."""
    env = gym.make(name, disable_env_checker=True).unwrapped
    env.reset(seed=0)
    action = np.zeros(env.action_space.n, np.int8)

    def play() -> None:
        for _ in range(10):
            _, _, terminated, truncated, _ = env.step(action)
            if terminated or truncated:
                env.reset()

    return 10, play


def play_batch(name: str) -> Play:
    """The number of games of a batch, and a function that plays a round of them and names no UAV."""
    envs = gym.make_vec(name, GAMES, autoreset_mode="SameStep")
    envs.reset(seed=0)
    actions = np.zeros(envs.action_space.shape, np.int8)
    return GAMES, lambda: envs.step(actions)


def race_batch(name: str, turns: int) -> dict[str, object]:
    """A batch of games against a single environment."""
    return race(f"a batch of {GAMES} games over a single one", turns, play_batch(name), play_one(name))


def make_plans(games: Any, count: int) -> list[dict[str, np.ndarray]]:
    """Ten actions of all agents of a batch: observers do nothing, heads choose at random."""
    rng = np.random.default_rng(0)

    def act(role: str) -> np.ndarray:
        space, shape = games.action_spaces[role], (count, games.roles[role])
        sizes = space.nvec if role == "head" else np.ones(space.shape, int)
        return rng.integers(0, sizes, (*shape, *space.shape))

    return [{role: act(role) for role in games.roles} for _ in range(10)]


def play_several_agents(name: str, count: int, **arguments: Any) -> Play:
    """The agents of a batch of games, and a function that plays a round of them."""
    games = importlib.import_module(f"usnet_env.multiagent.{name}").batch_env(count, **arguments)
    games.reset(seed=0)
    turn = cycle(make_plans(games, count))

    def play() -> None:
        games.step(next(turn))
        if (over := ~games.active["observer"].any(axis=1)).any():
            games.reset(games=over)

    return count * sum(games.roles.values()), play


def race_several_agents(name: str, turns: int) -> dict[str, object]:
    """A batch of small games of several agents against a single one; observers do nothing, heads choose at random."""
    count = 4 * GAMES
    env = importlib.import_module(f"usnet_env.multiagent.{name}").parallel_env(**SMALL_GAME)
    env.reset(seed=0)
    plans = make_plans(env.games, 1)

    def play_alone() -> None:
        for plan in plans:
            pairs = [(agent, agent.rsplit("_", 1)) for agent in env.agents]
            env.step({agent: plan[role][0, int(j)] for agent, (role, j) in pairs})
            if not env.agents:
                env.reset()

    agents = len(env.possible_agents)
    choices = ", heads choose at random" * ("head" in env.games.roles)
    title = f"a batch of {count} games over a single one, N = {SMALL_GAME['uavs']}{choices}"
    return race(title, turns, play_several_agents(name, count, **SMALL_GAME), (agents * len(plans), play_alone))


def measure_peers(turns: int) -> dict[str, object]:
    """Games of several agents, of this package and of others; the same number of games at once, but of MPE2's."""
    import vmas  # type: ignore[import-not-found]  # no extra installs it
    from mpe2 import simple_tag_v3  # type: ignore[import-not-found]  # no extra installs it

    count, steps = 4 * GAMES, {}
    contestants: dict[str, Play] = {}
    for name in SEVERAL:
        contestants[name] = play_several_agents(name, count, **SMALL_GAME)
        steps[name] = count * SMALL_GAME["uavs"] * (SMALL_GAME["observation_steps"] + 4)
    for name in ("simple_tag", "flocking"):
        env = vmas.make_env(name, num_envs=count, device="cpu", seed=0)
        actions = [env.get_random_action(agent) for agent in env.agents]
        contestants[f"VMAS {name}"] = count * len(actions), partial(env.step, actions)
    tag = simple_tag_v3.parallel_env()
    tag.reset(seed=0)
    chosen = dict.fromkeys(tag.agents, 1)

    def play_tag() -> None:
        for _ in range(10):
            tag.step(chosen)
            if not tag.agents:
                tag.reset()

    contestants["MPE2 simple_tag"] = 10 * len(chosen), play_tag
    contestants["JaxMARL simple_tag"] = play_jaxmarl(count)
    seconds = take_turns(turns, *(play for _, play in contestants.values()))
    rates = np.array([decisions for decisions, _ in contestants.values()]) / seconds
    result: dict[str, object] = {}
    for (name, (decisions, _)), rate in zip(contestants.items(), rates.T, strict=True):
        speed = float(np.median(rate))
        flown = {"decisions_per_second": speed, "steps_per_second": speed * steps.get(name, decisions) / decisions}
        result[name] = describe("decisions a second over those of usnet_evasion_v0", rate / rates[:, 1], **flown)
    return result


def play_jaxmarl(count: int) -> Play:
    """A compiled loop of 100 steps of JaxMARL's games, with random actions."""
    import jax  # type: ignore[import-not-found]  # no extra installs it
    import jaxmarl  # type: ignore[import-not-found]  # no extra installs it

    env = jaxmarl.make("MPE_simple_tag_v3")

    def act(key: Any) -> dict[str, Any]:
        keys = jax.random.split(key, len(env.agents))
        return {agent: env.action_space(agent).sample(each) for agent, each in zip(env.agents, keys, strict=True)}

    def step(state: Any, key: Any) -> tuple[Any, Any]:
        keys = jax.random.split(key, count)
        _, state, rewards, _, _ = jax.vmap(env.step)(keys, state, jax.vmap(act)(keys))
        return state, rewards[env.agents[0]].sum()

    run = jax.jit(lambda state, key: jax.lax.scan(step, state, jax.random.split(key, 100)))
    _, state = jax.vmap(env.reset)(jax.random.split(jax.random.key(0), count))
    return 100 * count * len(env.agents), lambda: jax.block_until_ready(run(state, jax.random.key(1)))


def race_sb3(turns: int) -> dict[str, object]:
    """The batch in Stable-Baselines3 against its vectorisation of single environments."""
    from stable_baselines3.common.vec_env import DummyVecEnv

    from usnet_env.frameworks.sb3 import SwarmVecEnv

    name = f"USNET/{BATCHES[0]}"
    contestants: dict[int, Any] = {GAMES: SwarmVecEnv(name, GAMES), 8: DummyVecEnv([lambda: gym.make(name)] * 8)}
    for envs in contestants.values():
        envs.reset()
    plays = [(games, partial(envs.step, np.zeros((games, 8), np.int8))) for games, envs in contestants.items()]
    return race("SwarmVecEnv of Stable-Baselines3 over its DummyVecEnv, without learning", turns, *plays)


def race_torchrl(turns: int) -> dict[str, object]:
    """The batch in TorchRL against its vectorisation of single environments."""
    from torchrl.envs import GymWrapper, SerialEnv

    from usnet_env.envs.wrappers import BoxMasks
    from usnet_env.frameworks.torchrl import SwarmEnv

    name = f"USNET/{BATCHES[0]}"
    single = SerialEnv(8, lambda: GymWrapper(BoxMasks(gym.make(name, disable_env_checker=True))))
    vector = SwarmEnv(name, GAMES)

    def roll(envs: Any) -> Callable[[], object]:
        return lambda: envs.rollout(10, break_when_any_done=False)

    title = "SwarmEnv of TorchRL over its SerialEnv, random actions"
    return race(title, turns, (10 * GAMES, roll(vector)), (80, roll(single)))


PARTS: dict[str, Callable[[int], dict[str, object]]] = {
    "stepping": lambda turns: {follow: measure_stepping(turns, follow=follow) for follow in FOLLOW},
    "field": lambda turns: {follow: measure_stepping(turns, follow=follow, memory=12) for follow in FIELD_MODELS},
    "kinematics": lambda turns: {
        name: measure_stepping(turns, kinematics=name) for name in ("varied_speed", "lagged", "limited", "layered")
    },
    "scaling": lambda turns: {follow: measure_scaling(follow, turns) for follow in ("pigeons", "vicsek", "couzin")},
    "batches": lambda turns: (
        {name: race_batch(f"USNET/{name}", turns) for name in BATCHES}
        | {name: race_several_agents(name, turns) for name in SEVERAL}
        | {"Stable-Baselines3": race_sb3(turns), "TorchRL": race_torchrl(turns)}
    ),
    "peers": measure_peers,
    "memory": measure_memory,
    "detectors": time_detectors,
    "threads": lambda turns: {
        f"{name}, N = {uavs}": compare_threads(FEWER_STEPS.get(name, name), uavs, turns)
        for name, uavs in (*((name, 30) for name in sorted(DETECTORS)), *LARGE)
    },
}


def main(argv: list[str] | None = None) -> None:
    parser = make_parser(__doc__)
    parser.add_argument("--turns", type=int, default=15)
    parser.add_argument("--out", type=Path, default=RESULTS / "speed.json")
    parser.add_argument("--parts", nargs="+", choices=list(PARTS), default=[part for part in PARTS if part != "peers"])
    options = parser.parse_args(argv)
    result = json.loads(options.out.read_text(encoding="utf-8")) if options.out.exists() else {}
    result |= {"machine": machine(), "versions": versions(("torch",)), "turns": options.turns}
    for part in options.parts:
        result[part] = PARTS[part](options.turns)
        write_text(options.out, json.dumps(result, indent=1) + "\n")
        print(json.dumps({part: result[part]}, indent=1), flush=True)


if __name__ == "__main__":
    main()
