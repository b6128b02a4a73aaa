"""Speed and memory of the simulator and the vector env, as ratios within one run.

    python benchmarks/speed.py                              # writes benchmarks/results/speed.json
    python benchmarks/speed.py --parts field scaling        # measures these parts again and keeps the others

The speed of a shared machine drifts, so contestants take turns, each turn gives one ratio, and the median counts. All
run in one thread, except VMAS, which uses PyTorch's threads.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import gymnasium as gym
import numpy as np
from running import RESULTS, make_parser
from scipy.spatial import cKDTree
from speed_helpers import alternate, describe_ratios, run, write_json

import usnet_env  # noqa: F401  registers the environments
from usnet_env.provenance import machine, versions
from usnet_env.swarm import SwarmConfig, advance, register_formation, start
from usnet_env.swarm.flock_follow import Flock
from usnet_env.swarm.follow import FIELD_MODELS
from usnet_env.swarm.formation import Roles

EPISODES, UAVS = 256, 82
FOLLOW = ["f1", "f2", "f3", "f4", "f5", "f6", "f7"]
KINEMATICS = ["varied_speed", "lagged", "limited", "layered"]
SIZES = [100, 300, 1000, 3000, 10_000]


def stepping(turns: int, **arguments: object) -> dict[str, object]:
    """A batch of swarms flies one round; NumPy draws as many float32 normals as that takes."""
    config = SwarmConfig(uavs=UAVS, **arguments)
    rngs = [np.random.default_rng(seed) for seed in range(EPISODES)]
    state = start(config, rngs)
    normals = config.steps * 3 * (UAVS + config.clusters)  # a followers' noise for all, the heads' own motion
    buffer, rng = np.empty(normals, np.float32), np.random.default_rng(0)

    def draw() -> None:
        for _ in range(EPISODES):
            rng.standard_normal(out=buffer, dtype=np.float32)

    taken = alternate(turns, lambda: advance(config, state, rngs), draw)
    return {
        "what": "rate of stepping over rate of drawing the same normals",
        "uav_steps_per_second": EPISODES * UAVS * config.steps / float(np.median(taken[:, 0])),
        "normals_per_second": EPISODES * normals / float(np.median(taken[:, 1])),
        **describe_ratios(taken[:, 1] / taken[:, 0]),
    }


def spread(rng: np.random.Generator, roles: Roles) -> np.ndarray:
    """Positions at a density that doesn't depend on N: 10,000 UAVs fill the arena of 1000 m x 1000 m x 100 m."""
    uavs = len(roles.root)
    side = 1000.0 * np.sqrt(uavs / SIZES[-1])
    return rng.uniform(0.0, (side, side, 100.0), (uavs, 3))


def count_near(place: np.ndarray, reach: float) -> tuple[float, float]:
    """Mean numbers of UAVs within ``reach`` metres of a UAV, and within 1.5 ``reach`` of it on each axis.

    The second is that of the UAVs in the 27 cells of a cell list, with which a UAV is compared.
    """
    tree = cKDTree(place)
    near = tree.query_ball_point(place, reach, return_length=True).mean() - 1
    return float(near), float(tree.query_ball_point(place, 1.5 * reach, p=np.inf, return_length=True).mean())


def scaling(follow: str, turns: int) -> dict[str, object]:
    """One cluster of N UAVs flies one round, at a fixed density; the sizes take turns.

    In a smaller arena more UAVs are near the border and are compared with fewer others. So for flocks the numbers of
    neighbours and of comparisons are measured, as means of the beginning and the end of the round.
    """
    register_formation("spread", spread, replace=True)
    rounds = []
    for uavs in SIZES:
        config = SwarmConfig(
            follow=follow,
            clusters=1,
            uavs=uavs,
            memory=12,
            observation_steps=20,
            formation="spread",
            mobility="straight",
        )
        rngs = [np.random.default_rng(0)]
        rounds.append((config, start(config, rngs), rngs))
    taken = alternate(turns, *(lambda one=one: advance(*one) for one in rounds))
    each = np.median(taken, axis=0) / [uavs * rounds[0][0].steps for uavs in SIZES]
    model, thousand = FIELD_MODELS[follow], SIZES.index(1000)
    measured = {
        "what": "seconds of a UAV-step against N, one cluster at a fixed density",
        "uavs": SIZES,
        "seconds_per_uav_step": each.tolist(),
        "growth": float(each[-1] / each[thousand]),
    }
    if isinstance(model, Flock):
        reach = max(model.alignment, model.attraction)
        ends = [(one[1], advance(*one)[0]) for one in rounds]
        counts = [np.mean([count_near(state.position[0], reach) for state in pair], axis=0) for pair in ends]
        neighbours, compared = np.transpose(counts)
        measured |= {
            "range": reach,
            "neighbours": neighbours.tolist(),
            "compared": compared.tolist(),
            "growth_per_comparison": float(each[-1] / compared[-1] / (each[thousand] / compared[thousand])),
        }
    return measured


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
        "over_simple_tag_v3": describe_ratios(rates["usnet"] / rates["simple_tag_v3"]),
        "over_vmas_flocking": describe_ratios(rates["usnet"] / rates["vmas_flocking"]),
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


PARTS: dict[str, Callable[[int], dict[str, object]]] = {
    "stepping": lambda turns: {follow: stepping(turns, follow=follow) for follow in FOLLOW},
    "field": lambda turns: {follow: stepping(turns, follow=follow, memory=12) for follow in FIELD_MODELS},
    "kinematics": lambda turns: {name: stepping(turns, kinematics=name) for name in KINEMATICS},
    "scaling": lambda turns: {follow: scaling(follow, turns) for follow in ("pigeons", "vicsek", "couzin")},
    "peers": peers,
    "memory": lambda turns: memory(),
}


def main() -> None:
    parser = make_parser(__doc__)
    parser.add_argument("--turns", type=int, default=15)
    parser.add_argument("--out", type=Path, default=RESULTS / "speed.json")
    parser.add_argument("--parts", nargs="+", choices=[*PARTS], default=[*PARTS], help="peers need the bench extra")
    arguments = parser.parse_args()
    turns = arguments.turns
    result: dict[str, object] = {}
    if arguments.parts != [*PARTS] and arguments.out.exists():
        result = json.loads(arguments.out.read_text())
    result |= {"machine": machine(), "versions": versions(("torch", "mpe2", "vmas")), "turns": turns}
    result |= {part: measure(turns) for part, measure in PARTS.items() if part in arguments.parts}
    write_json(arguments.out, result)
    for part in ("stepping", "field", "kinematics"):
        for name, row in result.get(part, {}).items():
            rate = row["uav_steps_per_second"] / 1e6
            print(f"{name}: {rate:6.1f} M UAV-steps/s, ratio {row['ratio']:.3f}")
    for name, row in result.get("scaling", {}).items():
        last = 1e9 * row["seconds_per_uav_step"][-1]
        print(f"{name}: {last:.0f} ns a UAV-step at N=10,000, {row['growth']:.2f} times that at N=1,000", end="")
        print(f"; of a comparison {row['growth_per_comparison']:.2f} times" if "compared" in row else "")
    if "peers" in result:
        for name in ("over_simple_tag_v3", "over_vmas_flocking"):
            print(f"{name}: {result['peers'][name]['ratio']:.1f}")
    if "memory" in result:
        print(f"memory: {result['memory']['bytes'] / 2**30:.2f} GiB")


if __name__ == "__main__":
    main()
