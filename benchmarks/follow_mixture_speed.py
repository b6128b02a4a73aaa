"""Speed and memory of follow-mixture, as ratios within one run, and whether it finds the heads meanwhile.

    OMP_NUM_THREADS=1 python benchmarks/follow_mixture_speed.py  # writes results/follow_mixture_speed.json

Four measurements (``benchmarks/tables.py`` makes the tables):

* ``window``: one window of 82 UAVs in 5 clusters against one pass of ``lagged-correlation`` (matrix products over all
  pairs and lags) over the same windows;
* ``growth``: one window of f1 as N grows, twice: with 5 clusters at any N, and with as many clusters for each UAV as
  5 for 82;
* ``memory``: of a fresh process that answers one window of 10,000 UAVs, both ways;
* ``gassl``: one head and 50 followers, beside GASSL, and which of the two names the head.

Seconds are those of the processor, as other work may run on the same cores. Contestants take turns, each turn gives one
ratio, and the median counts; what takes long has fewer turns, and says so.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from detectors.studies.common import FOLLOW
from speed_helpers import describe_ratios, run, write_json
from usnet_env.evaluation.statistics import rate_interval

from usnet_env import Window
from usnet_env.envs import MultiClusterEnv, SingleClusterEnv
from usnet_env.objectives import exact, multi_cluster_objective
from usnet_env.plugins import make_detector
from usnet_env.provenance import machine, versions

OURS, PEER = "follow-mixture", "lagged-correlation"
P1 = f"{OURS}(objective='P1')"
SEED = 2022
CLUSTERS, UAVS, STEPS = 5, 82, 100
SIZES = (82, 200, 500, 1000, 2000, 5000, 10_000)
PARTS = ("window", "growth", "memory", "gassl")
SERIES = ("clusters fixed", "clusters in proportion")
LARGEST = 10_000
FOLLOWERS = 50
PATIENCE = 30.0  # seconds after which a size is timed no further


MEMORY = """
import json, sys, gymnasium as gym, usnet_env
from usnet_env.plugins import make_detector
size = {"clusters": int(sys.argv[1]), "uavs": int(sys.argv[2])}
window = usnet_env.Window.from_observation(gym.make("USNET/MultiCluster-v0", follow="f1", **size).reset(seed=0)[0])
before = peak()
detector = make_detector(sys.argv[3])
detector.reset(0)
detector.detect(window)
print(json.dumps([before, peak()]))
"""


def seconds(function: Callable[[], object]) -> float:
    """Measure the processor seconds of a call."""
    begun = time.process_time()
    function()
    return time.process_time() - begun


def play(detector: object, window: Window) -> object:
    """Play an episode of one round: a reset, and one window."""
    detector.reset(0)
    return detector.detect(window)


def swarm(env: MultiClusterEnv | SingleClusterEnv, seed: int) -> tuple[Window, np.ndarray]:
    """A window, and its heads ``(N,)``."""
    observation, _ = env.reset(seed=seed)
    return Window.from_observation(observation), env.swarm.head.copy()


def clusters_of(series: str, uavs: int) -> int:
    return CLUSTERS if series == SERIES[0] else round(CLUSTERS * uavs / UAVS)


def windows(turns: int, count: int) -> dict[str, object]:
    """One window against one pass of lagged correlation, for each strategy."""
    detectors = {name: make_detector(name) for name in (OURS, PEER)}
    answer: dict[str, object] = {}
    for follow in FOLLOW:
        env = MultiClusterEnv(follow=follow, clusters=CLUSTERS, uavs=UAVS, observation_steps=STEPS)
        swarms = [swarm(env, SEED + k) for k in range(count)]
        found = [bool(exact(head, play(detectors[OURS], window).candidates)) for window, head in swarms]
        play(detectors[PEER], swarms[0][0])
        taken = np.empty((turns, count, 2))
        for turn in range(turns):
            for k, (window, _) in enumerate(swarms):
                taken[turn, k] = [seconds(partial(play, detector, window)) for detector in detectors.values()]
        ratios = taken[..., 0].sum(axis=1) / taken[..., 1].sum(axis=1)
        own, peer = np.median(taken, axis=(0, 1)).tolist()
        answer[follow] = {
            "seconds": own,
            "seconds_of_lagged_correlation": peer,
            **describe_ratios(ratios),
            "ratio_by_window": np.median(taken[..., 0] / taken[..., 1], axis=0).tolist(),
            "windows": count,
            "exact": float(np.mean(found)),
        }
        print(f"{follow}: {1e3 * own:.1f} ms, {answer[follow]['ratio']:.1f} passes of {PEER}", flush=True)
    return answer


def growth(series: str, sizes: tuple[int, ...], turns: int, count: int) -> dict[str, object]:
    """Seconds of a window as N grows. The first answer to a window is not timed, but tells what is found."""
    detector = make_detector(OURS)
    played = {}
    found: dict[int, list[dict[str, float]]] = {}
    taken: dict[int, list[float]] = {}
    for uavs in sizes:
        env = MultiClusterEnv(follow="f1", clusters=clusters_of(series, uavs), uavs=uavs, observation_steps=STEPS)
        played[uavs] = [swarm(env, SEED + k) for k in range(count)]
        found[uavs], taken[uavs] = [], []
        for window, head in played[uavs]:
            named = play(detector, window).candidates
            found[uavs].append(
                {
                    "exact": float(exact(head, named)),
                    "hits": float((head & named).sum() / head.sum()),
                    "redundant": float((named & ~head).sum()),
                    "objective": float(multi_cluster_objective(head, named[None])),
                }
            )
    for _ in range(turns):
        for uavs in sizes:
            if sum(taken[uavs]) * count <= PATIENCE:
                spent = [seconds(partial(play, detector, window)) for window, _ in played[uavs]]
                taken[uavs].append(float(np.mean(spent)))
    median = {uavs: float(np.median(taken[uavs])) for uavs in sizes}
    for uavs in sizes:
        print(f"N={uavs}, M={clusters_of(series, uavs)}: {median[uavs]:.3f} s", flush=True)
    logs = np.log([[uavs, median[uavs]] for uavs in sizes])
    between = np.diff(logs[:, 1]) / np.diff(logs[:, 0])
    return {
        "what": "seconds of one window of f1, and the power of N with which they grow",
        "sizes": {
            str(uavs): {
                "clusters": clusters_of(series, uavs),
                "seconds": median[uavs],
                "turns": len(taken[uavs]),
                "windows": count,
                **{
                    name: float(np.mean([one[name] for one in found[uavs]]))
                    for name in ("exact", "hits", "redundant", "objective")
                },
            }
            for uavs in sizes
        },
        "exponent": float((logs[-1, 1] - logs[0, 1]) / (logs[-1, 0] - logs[0, 0])),
        "exponent_fitted": float(np.polyfit(logs[:, 0], logs[:, 1], 1)[0]),
        "exponents_between": {
            f"{low}-{high}": float(power) for low, high, power in zip(sizes, sizes[1:], between, strict=False)
        },
    }


def memory(series: str) -> dict[str, object]:
    clusters = clusters_of(series, LARGEST)
    before, peak = run(MEMORY, clusters, LARGEST, OURS)
    return {
        "what": f"peak resident bytes of a process that answers one window of {LARGEST} UAVs",
        "clusters": clusters,
        "bytes": peak,
        "bytes_after_imports": before,
        "bytes_above_imports": peak - before,
    }


def beside_gassl(episodes: int) -> dict[str, object]:
    """One head and ``FOLLOWERS`` followers: seconds of both, and how often each names the head alone."""
    detectors = {"gassl": make_detector("gassl"), OURS: make_detector(P1)}
    answer: dict[str, object] = {}
    for follow in FOLLOW:
        env = SingleClusterEnv(follow=follow, followers=FOLLOWERS)
        taken, hits = np.empty((episodes, 2)), np.empty((episodes, 2))
        for detector in detectors.values():
            play(detector, swarm(env, SEED)[0])
        for episode in range(episodes):
            window, head = swarm(env, SEED + episode)
            for k, detector in enumerate(detectors.values()):
                answers = []
                taken[episode, k] = seconds(lambda found=answers, by=detector, w=window: found.append(play(by, w)))
                hits[episode, k] = exact(head, answers[0].candidates)
        rates = {}
        for k, name in enumerate(detectors):
            rate, low, high = rate_interval(hits[:, k])
            rates[name] = {"seconds": float(np.median(taken[:, k])), "named": rate, "low": low, "high": high}
        answer[follow] = {
            "what": f"times faster than gassl, one head and {FOLLOWERS} followers",
            "episodes": episodes,
            **describe_ratios(taken[:, 0] / taken[:, 1]),
            **rates,
        }
        print(f"{follow}: {answer[follow]['ratio']:.0f} times as fast as GASSL", flush=True)
    return answer


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--turns", type=int, default=5)
    parser.add_argument("--windows", type=int, default=20, help="of each strategy against lagged correlation")
    parser.add_argument("--swarms", type=int, default=3, help="of each size")
    parser.add_argument("--episodes", type=int, default=20, help="of each strategy beside GASSL")
    parser.add_argument("--sizes", type=int, nargs="+", default=SIZES)
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "results" / "follow_mixture_speed.json")
    parser.add_argument("--part", nargs="+", choices=PARTS, default=PARTS, help="the others stay as the file has them")
    arguments = parser.parse_args()
    sizes = tuple(sorted(arguments.sizes))
    parts: dict[str, Callable[[], object]] = {
        "window": lambda: windows(arguments.turns, arguments.windows),
        "growth": lambda: {series: growth(series, sizes, arguments.turns, arguments.swarms) for series in SERIES},
        "memory": lambda: {series: memory(series) for series in SERIES},
        "gassl": lambda: beside_gassl(arguments.episodes),
    }
    about = {
        "machine": machine(),
        "versions": versions(("torch",)),
        "seconds": "processor time",
        "turns": arguments.turns,
    }
    earlier = json.loads(arguments.out.read_text()) if arguments.out.exists() else {}
    measured = {part: parts[part]() for part in PARTS if part in arguments.part}
    write_json(arguments.out, earlier | about | measured)


if __name__ == "__main__":
    main()
