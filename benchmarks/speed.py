"""Speed and memory of the simulator and the vector env, as ratios within one run.

    python benchmarks/speed.py                  # writes benchmarks/results/speed.json

The speed of a shared machine drifts, so contestants take turns, each turn gives one ratio, and the median counts. All
run in one thread, except VMAS, which uses PyTorch's threads.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path

import gymnasium as gym
import numpy as np
from speed_helpers import run, write_json

import usnet_env  # noqa: F401  registers the environments
from usnet_env.provenance import machine, versions
from usnet_env.swarm import SwarmConfig, advance, start

EPISODES, UAVS = 256, 82
FOLLOW = ["f1", "f2", "f3", "f4", "f5", "f6", "f7"]


def seconds(function: Callable[[], object]) -> float:
    begun = time.perf_counter()
    function()
    return time.perf_counter() - begun


def alternate(turns: int, *contestants: Callable[[], object]) -> np.ndarray:
    """Seconds ``(turns, contestants)`` of contestants that take turns, after one warm-up each."""
    for contestant in contestants:
        contestant()
    return np.array([[seconds(contestant) for contestant in contestants] for _ in range(turns)])


def stepping(follow: str, turns: int) -> dict[str, object]:
    """A batch of swarms flies one round; NumPy draws as many float32 normals as that takes."""
    config = SwarmConfig(follow=follow, uavs=UAVS)
    rngs = [np.random.default_rng(seed) for seed in range(EPISODES)]
    state = start(config, rngs)
    normals = config.steps * 3 * (UAVS + config.clusters)  # a followers' noise for all, the heads' own motion
    buffer, rng = np.empty(normals, np.float32), np.random.default_rng(0)

    def draw() -> None:
        for _ in range(EPISODES):
            rng.standard_normal(out=buffer, dtype=np.float32)

    taken = alternate(turns, lambda: advance(config, state, rngs), draw)
    ratios = taken[:, 1] / taken[:, 0]
    return {
        "what": "rate of stepping over rate of drawing the same normals",
        "uav_steps_per_second": EPISODES * UAVS * config.steps / float(np.median(taken[:, 0])),
        "normals_per_second": EPISODES * normals / float(np.median(taken[:, 1])),
        "ratio": float(np.median(ratios)),
        "ratios": ratios.tolist(),
    }


def peers(turns: int) -> dict[str, object]:
    """Agent-steps a second of the vector env, of MPE2's simple_tag and of VMAS' flocking, in turns."""
    import torch
    import vmas
    from mpe2 import simple_tag_v3

    ours = gym.make_vec("USNET/MultiCluster-v0", num_envs=EPISODES)
    ours.reset(seed=0)
    actions = np.random.default_rng(0).random((EPISODES, UAVS)) < 0.05
    steps_flown = ours.unwrapped.config.steps

    def play_ours() -> int:
        for _ in range(4):
            ours.step(actions.astype(np.int8))
        return 4 * EPISODES * UAVS * steps_flown

    tag = simple_tag_v3.parallel_env(num_good=3, num_adversaries=7, num_obstacles=2, max_cycles=10**9)
    tag.reset(seed=0)
    tag_actions = {agent: int(tag.action_space(agent).sample()) for agent in tag.agents}

    def play_tag() -> int:
        for _ in range(300):
            tag.step(tag_actions)
        return 300 * len(tag_actions)

    flock = vmas.make_env("flocking", num_envs=4096, device="cpu", n_agents=10, seed=0)
    flock_actions = [torch.rand(4096, 2) * 2 - 1 for _ in range(10)]

    def play_flock() -> int:
        for _ in range(3):
            flock.step(flock_actions)
        return 3 * 4096 * 10

    contestants = {"usnet": play_ours, "simple_tag_v3": play_tag, "vmas_flocking": play_flock}
    counts = {name: play() for name, play in contestants.items()}
    taken = alternate(turns, *contestants.values())
    rates = {name: counts[name] / taken[:, k] for k, name in enumerate(contestants)}
    return {
        "what": "agent-steps a second; simple_tag_v3 parallel env with 10 agents, flocking at 4,096 envs of 10 agents",
        "agent_steps_per_second": {name: float(np.median(rate)) for name, rate in rates.items()},
        "over_simple_tag_v3": {
            "ratio": float(np.median(rates["usnet"] / rates["simple_tag_v3"])),
            "ratios": (rates["usnet"] / rates["simple_tag_v3"]).tolist(),
        },
        "over_vmas_flocking": {
            "ratio": float(np.median(rates["usnet"] / rates["vmas_flocking"])),
            "ratios": (rates["usnet"] / rates["vmas_flocking"]).tolist(),
        },
    }


def memory() -> dict[str, object]:
    """Peak resident memory of a process that plays 1,000 swarms of N=82 at once."""
    peak = run(
        "import numpy as np, gymnasium as gym, usnet_env\n"
        "envs = gym.make_vec('USNET/MultiCluster-v0', num_envs=1000)\n"
        "observation, _ = envs.reset(seed=0)\n"
        "for _ in range(3): observation, *_ = envs.step(np.random.default_rng(0).random((1000, 82)) < 0.05)\n"
        "print(peak())\n"
    )
    return {"what": "peak resident bytes, 1,000 swarms of 82 UAVs", "bytes": peak}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--turns", type=int, default=15)
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "results" / "speed.json")
    parser.add_argument("--skip-peers", action="store_true", help="without MPE2 and VMAS (the bench extra)")
    arguments = parser.parse_args()
    result: dict[str, object] = {
        "machine": machine(),
        "versions": versions(("torch", "mpe2", "vmas")),
        "turns": arguments.turns,
    }
    result["stepping"] = {follow: stepping(follow, arguments.turns) for follow in FOLLOW}
    if not arguments.skip_peers:
        result["peers"] = peers(arguments.turns)
    result["memory"] = memory()
    write_json(arguments.out, result)
    for follow, row in result["stepping"].items():
        rate = row["uav_steps_per_second"] / 1e6
        print(f"{follow}: {rate:6.1f} M UAV-steps/s, ratio {row['ratio']:.3f}")
    if "peers" in result:
        for name in ("over_simple_tag_v3", "over_vmas_flocking"):
            print(f"{name}: {result['peers'][name]['ratio']:.1f}")
    print(f"memory: {result['memory']['bytes'] / 2**30:.2f} GiB")


if __name__ == "__main__":
    main()
