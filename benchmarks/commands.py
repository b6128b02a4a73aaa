"""The exact commands that make every committed file of benchmarks/results, row for row.

``benchmarks/README.md`` is written from this list (``python benchmarks/tables.py``), and a test holds the arguments of
the commands against what the files record of themselves. Every command goes on from the rows that are there, so a file
that several commands make can be made by all of them in any order. All run from the root of the repository, with
``OMP_NUM_THREADS=1`` where cores are shared with other work.
"""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["RESULTS", "Result", "commands_of"]


@dataclass(frozen=True)
class Result:
    """Files that the same commands make.

    Args:
        what: what is measured.
        files: paths below benchmarks/results; a folder ends in ``/``.
        commands: in any order.
    """

    what: str
    files: tuple[str, ...]
    commands: tuple[str, ...]


def _tier(tier: str, *steps: str) -> Result:
    """A tier of follow_mixture.py; each step is a number of episodes, then whatever follows it."""
    script = f"python benchmarks/follow_mixture.py --tier {tier}"
    return Result(_TIERS[tier], (f"follow_mixture/{tier}.csv",), tuple(f"{script} --episodes {step}" for step in steps))


_TIERS = {
    "paper": "P2 on the paper's tier: iid heads, M=5, N=82",
    "sizes": "P2, M from 2 to 20, N from 20 to 237",
    "smooth": "P2, smooth heads with jitter",
    "straight": "P2, straight heads",
    "short": "P2, short windows",
    "noise": "P2, noisy positions",
    "missed": "P2, missed samples",
    "sampled": "P2, every second sample",
    "decoys": "P2 with 1, 3 or 10 decoys",
    "silence": "no UAV follows another",
    "shifted": "every track shifted in time by a different amount",
    "P1": "P1 with and without a decoy",
    "strategies": "P2 with follow strategies beside f1 to f7",
}
_SHORT_CELLS = ",".join(f"f{f}:{m}" for f in range(1, 8) for m in (2, 3, 5, 10, 15))
_LONG_CELLS = ",".join(f"f{f}:{m}" for f in range(1, 8) for m in (20, 25, 30, 40, 50))
_SIZES = {
    "2-15": ",".join(f"f{f}:{m}" for f in range(1, 8) for m in (2, 5, 15)),
    "2-10": ",".join(f"f{f}:{m}" for f in range(1, 8) for m in (2, 3, 5, 10)),
    "15-50": ",".join(f"f{f}:{m}" for f in range(1, 8) for m in (15, 20, 25, 30, 40, 50)),
    "50": ",".join(f"f{f}:50" for f in range(1, 8)),
}


def _table2(name: str, *commands: str) -> Result:
    files = tuple(f"table2/{name}.{kind}" for kind in ("csv", "md", "png"))
    out = "--out benchmarks/results/table2"
    return Result(
        "P1: detection rates", files, tuple(f"usnet reproduce table2 {out} {command}" for command in commands)
    )


#: What both cores of follow-mixture played, by seed.
_BOTH_PLAYED = (
    "--seed 9191 --tier paper --episodes 100 --detectors follow-mixture",
    "--seed 9191 --tier sizes smooth short missed strategies --episodes 50 --detectors follow-mixture",
    "--seed 9191 --tier straight --cell jitter --episodes 50 --detectors follow-mixture",
    "--seed 9191 --tier P1 --episodes 50 --detectors \"follow-mixture(objective='P1')\"",
    "--seed 7077 --tier noise --episodes 20 --detectors follow-mixture",
    "--seed 7077 --tier decoys --episodes 5 --detectors follow-mixture",
    "--seed 7077 --tier silence --episodes 50 --detectors \"follow-mixture(policy='map')\"",
)


def _cores(core: str, name: str, *before: str) -> Result:
    """The rows of one core in all tiers, in one file."""
    script = f"python benchmarks/follow_mixture.py --results out/{core}"
    return Result(
        f"the {core} core of follow-mixture on the same swarms",
        (f"former_core/{name}.csv.gz",),
        (
            *before,
            *(f"{script} {step}" for step in _BOTH_PLAYED),
            *(["git checkout -"] if before else []),
            f"{script} --pack benchmarks/results/former_core/{name}.csv.gz",
        ),
    )


_SMOOTH = "--mobility gauss_markov --head-jitter"
_WAYPOINT = "--mobility waypoint --head-jitter"

RESULTS: tuple[Result, ...] = (
    Result("P2 on the paper's tier", ("multi_cluster/",), ("benchmarks/multi_cluster.sh",)),
    _tier(
        "paper",
        "100 --detectors follow-mixture",
        "2 --detectors \"follow-mixture(policy='map')\"",
        "30 --detectors lagged-regression destroy-all",
        "3 --detectors random none granger factions",
    ),
    _tier(
        "sizes",
        "50 --detectors follow-mixture",
        "2 --detectors \"follow-mixture(policy='map')\"",
        "50 --detectors lagged-regression destroy-all",
        "3 --detectors random none granger factions",
    ),
    _tier(
        "smooth",
        "50 --detectors follow-mixture",
        "2 --detectors \"follow-mixture(policy='map')\"",
        "50 --detectors lagged-regression destroy-all",
        "3 --detectors random none granger factions",
    ),
    _tier(
        "straight",
        "50 --cell jitter --detectors follow-mixture",
        "5 --detectors follow-mixture",
        "2 --detectors \"follow-mixture(policy='map')\"",
        "50 --detectors lagged-regression destroy-all",
        "3 --detectors random none granger factions",
    ),
    _tier(
        "short",
        "50 --detectors follow-mixture",
        "2 --detectors \"follow-mixture(policy='map')\"",
        "50 --detectors lagged-regression destroy-all",
        "3 --detectors random none granger factions",
    ),
    _tier(
        "noise",
        "50 --detectors follow-mixture",
        "50 --detectors lagged-regression destroy-all",
        "3 --detectors random none granger factions",
    ),
    _tier(
        "missed",
        "50 --detectors follow-mixture",
        "2 --detectors \"follow-mixture(policy='map')\"",
        "50 --detectors lagged-regression destroy-all",
        "3 --detectors random none granger factions",
    ),
    _tier(
        "sampled",
        "10 --detectors follow-mixture",
        "5 --detectors lagged-regression destroy-all",
        "3 --detectors random none granger factions",
    ),
    _tier(
        "decoys",
        "30 --detectors follow-mixture \"follow-mixture(policy='map')\"",
        "5 --detectors learned \"learned(policy='map')\" random none",
        "30 --detectors lagged-regression destroy-all",
        "3 --detectors granger factions",
    ),
    _tier(
        "silence",
        "50 --detectors \"follow-mixture(policy='map')\"",
        "10 --detectors follow-mixture",
        "5 --detectors learned \"learned(policy='map')\" random none",
        "30 --detectors lagged-regression destroy-all",
        "3 --detectors granger factions",
    ),
    _tier(
        "shifted",
        "5 --detectors \"follow-mixture(policy='map')\" lagged-regression destroy-all",
        "3 --detectors random none granger factions",
    ),
    _tier(
        "P1",
        "50 --detectors \"follow-mixture(objective='P1')\"",
        "10 --detectors follow-mixture \"follow-mixture(policy='map')\" learned \"learned(policy='map')\" random none",
        "100 --detectors lagged-regression destroy-all",
        "3 --detectors granger factions",
    ),
    _tier(
        "strategies",
        "50 --detectors follow-mixture",
        "50 --detectors lagged-regression destroy-all",
        "3 --detectors random none granger factions",
    ),
    _cores("former", "rows", "git checkout dcdecd2  # has the code of the former core"),
    _cores("present", "present"),
    Result(
        "the former core of follow-mixture with each of its rules switched off, on tuning seeds",
        ("former_core/ablation.csv", "former_core/ablation.md"),
        (
            "git checkout dcdecd2  # has the former core and the script; it writes results/follow_mixture/ablation.csv",
            *(
                f"python benchmarks/follow_mixture_ablation.py --tier {step}"
                for step in (
                    "random --games 121",
                    "random --second --games 33",
                    "paper smooth straight strategies missed short P1 sampled sizes --games 10 4 1 1 1 1 1 1 1",
                    "straight --cell jitter --games 2",
                    "straight --cell f1-jitter f2-jitter f3-jitter f4-jitter f5-jitter --games 3",
                    "noise --cell f1-0 f2-0 f3-0 f4-0 f5-0 f6-0 f7-0 f1-1 f2-1 f3-1 f1-gauss_markov-0.3 "
                    "f2-gauss_markov-0.3 f3-gauss_markov-0.3 --games 1",
                    "decoys --cell 2 iid-3 iid-10 gauss_markov-3 --games 1",
                    "silence --cell iid gauss_markov --games 1",
                )
            ),
            "python benchmarks/tables.py  # writes results/follow_mixture/ablation.md",
        ),
    ),
    Result(
        "which feature class of follow-mixture contains a strategy",
        ("follow_mixture/classes.csv",),
        ("python benchmarks/strategy_classes.py",),
    ),
    Result(
        "probabilities of follow-mixture against the share of heads",
        ("follow_mixture/reliability.png",),
        ("python benchmarks/tables.py --figures",),
    ),
    Result(
        "thresholds of follow-mixture",
        ("follow_mixture_thresholds.csv",),
        (
            "python benchmarks/threshold_ablation.py --games 1 --random 60 "
            "--tier paper smooth straight short strategies silence",
        ),
    ),
    Result(
        "swarms of the calibration of follow-mixture",
        ("follow_mixture_calibration.csv.gz",),
        ("usnet train follow-mixture --out runs/follow-mixture  # its rows.csv, compressed",),
    ),
    Result(
        "speed and memory of follow-mixture",
        ("follow_mixture_speed.json",),
        ("python benchmarks/follow_mixture_speed.py",),
    ),
    Result("learned on strategies that it was not trained on", ("learned.csv",), ("python benchmarks/learned.py",)),
    Result("learned in harder swarms", ("learned_limits.csv",), ("python benchmarks/learned.py --limits --games 10",)),
    Result(
        "losses of the training of learned",
        ("learned_losses.csv",),
        ("usnet train learned --out runs/learned  # its losses.csv",),
    ),
    Result(
        "an observer trained by PPO (needs the extra rl)",
        (
            "ppo_observer.csv",
            "ppo_observer.json",
            "ppo_observer.safetensors",
            "ppo_observer_curve.csv",
        ),
        ("python benchmarks/ppo_observer.py",),
    ),
    Result(
        "observers against the policies of the swarm",
        ("multiagent_payoff.csv",),
        ("python benchmarks/multiagent_payoff.py",),
    ),
    Result(
        "a swarm trained by PPO against a detector (needs the extra rl)",
        ("multiagent_ppo.csv", "multiagent_ppo_curve.csv", "multiagent_ppo.png"),
        ("python benchmarks/multiagent_ppo.py",),
    ),
    Result(
        "several observers, rules of fusion and ranges",
        ("multiagent_observers.csv",),
        ("python benchmarks/multiagent_observers.py",),
    ),
    Result(
        "tables that pages of docs include",
        (
            "learned.md",
            "ppo_observer.md",
            "multiagent_payoff.md",
            "multiagent_ppo.md",
            "multiagent_observers.md",
        ),
        ("python benchmarks/tables.py",),
    ),
    Result(
        "speed and memory of the simulator (needs the extra bench)", ("speed.json",), ("python benchmarks/speed.py",)
    ),
    Result(
        "recorded tracks: memory and right heads on a CSV of 200 MB with 2,000 ids",
        ("tracks_speed.json",),
        ("OMP_NUM_THREADS=1 python benchmarks/tracks_speed.py",),
    ),
    Result(
        "recorded tracks: leaders named in two public sets",
        ("real_tracks.csv",),
        (
            "python examples/fetch_tracks.py ants cars --out data",
            "OMP_NUM_THREADS=1 python benchmarks/real_tracks.py data",
        ),
    ),
    Result(
        "speed and memory of the evaluator's store, summary and isolation",
        ("engine_speed.json",),
        ("OMP_NUM_THREADS=1 python benchmarks/engine_speed.py",),
    ),
    _table2(
        "episodes-seed2022",
        '--seed 2022 --detector neural-granger --detector "lagged-regression(clusters=1)"',
        f"--seed 2022 --detector gassl --episodes 20 --cells {_SHORT_CELLS}",
        f"--seed 2022 --detector gassl --episodes 10 --cells {_LONG_CELLS}",
    ),
    _table2(
        "episodes-decoys1-seed2022",
        f"--seed 2022 --decoys 1 --detector neural-granger --episodes 50 --cells {_SIZES['2-10']}",
        f"--seed 2022 --decoys 1 --detector neural-granger --episodes 30 --cells {_SIZES['15-50']}",
        f"--seed 2022 --decoys 1 --detector gassl --episodes 20 --cells {_SIZES['2-15']}",
    ),
    _table2("episodes-decoys3-seed2022", "--seed 2022 --decoys 3 --detector neural-granger --episodes 10"),
    _table2(
        "episodes-gauss_markov-jitter-seed2022",
        f"--seed 2022 {_SMOOTH} --detector neural-granger --episodes 20 --cells {_SIZES['2-15']},{_SIZES['50']}",
    ),
    _table2(
        "episodes-decoys1-gauss_markov-jitter-seed2022",
        f"--seed 2022 --decoys 1 {_SMOOTH} --detector neural-granger --episodes 40 --cells {_SIZES['2-15']}",
        f"--seed 2022 --decoys 1 {_SMOOTH} --detector neural-granger --episodes 20 --cells {_SIZES['50']}",
    ),
    _table2(
        "episodes-waypoint-jitter-seed2022",
        f"--seed 2022 {_WAYPOINT} --detector neural-granger --episodes 20 --cells {_SIZES['2-15']},{_SIZES['50']}",
    ),
    _table2(
        "episodes-decoys1-waypoint-jitter-seed2022",
        f"--seed 2022 --decoys 1 {_WAYPOINT} --detector neural-granger --episodes 60 --cells {_SIZES['2-15']}",
        f"--seed 2022 --decoys 1 {_WAYPOINT} --detector neural-granger --episodes 20 --cells {_SIZES['50']}",
    ),
    Result(
        "P2: rounds against strategy, M and N",
        tuple(f"rounds/rounds-seed2022.{kind}" for kind in ("csv", "md", "png")),
        (
            "usnet reproduce rounds --out benchmarks/results/rounds --seed 2022 --study follow --study clusters "
            "--study example --detector lead-votes --detector lagged-regression --episodes 10",
            "usnet reproduce rounds --out benchmarks/results/rounds --seed 2022 --study follow --study clusters "
            "--study uavs --study example --detector mc-gassl --no-trivial --episodes 10",
            "usnet reproduce rounds --out benchmarks/results/rounds --seed 2022 --study uavs "
            "--detector lead-votes --detector lagged-regression --episodes 5",
        ),
    ),
    Result(
        "P2 behind Gauss-Markov heads with jitter",
        tuple(f"rounds/rounds-gauss_markov-jitter-seed2022.{kind}" for kind in ("csv", "md", "png")),
        (
            f"usnet reproduce rounds --out benchmarks/results/rounds --seed 2022 --study follow {_SMOOTH} "
            "--detector lead-votes --detector lagged-regression --episodes 5",
        ),
    ),
    Result(
        "purity and head-in-cluster of every clusterer",
        tuple(f"purity/purity-seed2022.{kind}" for kind in ("csv", "md", "png")),
        ("usnet reproduce purity --out benchmarks/results/purity --seed 2022 --episodes 30",),
    ),
    Result(
        "losses of metric learning from three starts",
        tuple(f"metric_learning/losses-F30-E1000-seed2022.{kind}" for kind in ("csv", "md", "png")),
        ("usnet reproduce meta --out benchmarks/results/metric_learning --seed 2022 --strategies 30 --episodes 1000",),
    ),
    Result(
        "gassl by the initial scale of its attention, on tuning seeds",
        tuple(f"gassl_gain/episodes-seed100.{kind}" for kind in ("csv", "md", "png")),
        (
            "usnet reproduce table2 --out benchmarks/results/gassl_gain --seed 100 --episodes 10 "
            '--cells f1:2,f1:5,f4:2,f4:5,f6:2,f6:5 --detector "gassl(gain=0.5)" '
            '--detector "gassl(gain=1.0)" --detector "gassl(gain=2.0)" --detector gassl --detector "gassl(gain=4.0)"',
        ),
    ),
    Result(
        "what a head adds to a follower's own past",
        ("neural_granger_own_history.csv",),
        ("python benchmarks/neural_granger_own_history.py",),
    ),
    Result(
        "neural-granger with a strategy of products of axes",
        ("neural_granger_products.csv",),
        ("python benchmarks/neural_granger_products.py",),
    ),
    Result("the gate of neural-granger", ("neural_granger_gate.csv",), ("python benchmarks/neural_granger_gate.py",)),
    Result("three rules for missed samples, on tuning seeds", ("gaps.csv",), ("python benchmarks/gaps.py",)),
)


def commands_of(name: str) -> tuple[str, ...]:
    """The commands that make a file or folder below benchmarks/results; none if it has no entry."""
    return tuple(command for result in RESULTS if name in result.files for command in result.commands)
