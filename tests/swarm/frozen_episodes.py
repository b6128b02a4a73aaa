"""Episodes of every model and version, as numbers on disk.

    python tests/swarm/frozen_episodes.py       # adds what is missing to data/frozen_episodes.json

An entry is never changed: a model that flies differently gets a new ``version``, and so a new entry. The numbers are
positions rather than a hash of them, because processors and libraries may differ in the last bit of a float.
"""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from usnet_env.envs.distribution import DISTRIBUTIONS
from usnet_env.swarm import SwarmConfig, advance, destroy, start
from usnet_env.swarm.follow import CONTROLS, FIELD_MODELS, LED_MODELS, LIMIT_MODELS
from usnet_env.swarm.kinematics import KINEMATICS

__all__ = ["FILE", "make_entries"]

FILE = Path(__file__).parent / "data" / "frozen_episodes.json"


def fly(**arguments: Any) -> list[float]:
    """Positions of four UAVs in the middle and at the end of two windows with a destruction between them."""
    config = SwarmConfig(
        **{
            "clusters": 3, "uavs": 30, "memory": 12, "observation_steps": 30, "formation": "around",
            "mobility": "gauss_markov", **arguments,
        }
    )  # fmt: skip
    rng = np.random.default_rng(7)
    state, places = start(config, [rng]), []
    for _ in range(2):
        state, window = advance(config, state, [rng])
        places.append(window.position[0, [15, 30]][:, [3, 9, 17, 28]])
        gone = np.zeros((1, 30), bool)
        gone[0, [1, 5, 20]] = True
        gone[0, np.flatnonzero(state.head[0])[:1]] = True
        state = destroy(state, gone)
    return np.round(np.concatenate(places).ravel().astype(float), 3).tolist()


def make_entries() -> dict[str, Callable[[], Any]]:
    """What makes each entry, by its name: kind, model and version."""
    entries: dict[str, Callable[[], Any]] = {
        **{
            f"follow {name} {model.version}": lambda name=name: fly(follow=name, memory=30 if name == "late" else 12)
            for name, model in {**FIELD_MODELS, **CONTROLS, **LIMIT_MODELS}.items()
        },
        **{
            f"led {name} {model.version}": lambda name=name: fly(follow=name, led_by=(1, 4), decoys=2)
            for name, model in {**LED_MODELS, "frontness": FIELD_MODELS["frontness"]}.items()
        },
        **{
            f"kinematics {name} {KINEMATICS[name].version}": lambda name=name: fly(follow="f2", kinematics=name)
            for name in ("unit", "varied_speed", "lagged", "limited", "layered")
        },
        **{
            f"open-{number} 1": lambda number=number: fly(follow=f"open-{number}", follow_seed=1)
            for number in (1, 34, 67, 12, 45, 78, 27)  # all parts of all kinds
        },
        **{
            f"second-{number} 1": lambda number=number: fly(follow=f"second-{number}", follow_seed=1)
            for number in (1, 23, 45, 12, 31, 53)  # all parts of all kinds
        },
        "bystanders 1": lambda: fly(follow="f2", bystanders=6, traffic=7),
        "gathered 1": lambda: fly(follow="f2", formation="gathered", decoys=2, bystanders=4, traffic=3, clutter=3),
        "clutter 1": lambda: fly(follow="f2", traffic=3, clutter=8),
        "course_noise 1": lambda: fly(follow="f2", position_noise=1.0, course_noise=3.0),
        **{
            f"distribution {name}": lambda each=each: [each.draw(np.random.default_rng(s)) for s in range(4)]
            for name, each in DISTRIBUTIONS.items()
        },
    }
    return entries


if __name__ == "__main__":
    frozen = json.loads(FILE.read_text(encoding="utf-8")) if FILE.exists() else {}
    frozen |= {name: make() for name, make in make_entries().items() if name not in frozen}
    lines = ",\n".join(f" {json.dumps(name)}: {json.dumps(entry)}" for name, entry in sorted(frozen.items()))
    FILE.write_text(f"{{\n{lines}\n}}\n", encoding="utf-8")
