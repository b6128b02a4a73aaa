"""An environment that another module registers, evaluated in this process and in another one."""

import sys

import usnet_env

MODULE = """
import numpy as np
from usnet_env import register_follow_strategy

register_follow_strategy("test-mirror", lambda inputs: -inputs.head_velocity[:, 0], lags=1)
"""


def test_a_module_in_front_of_the_id_is_imported_in_a_worker_process(tmp_path, monkeypatch):
    (tmp_path / "mirrored_swarm.py").write_text(MODULE, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    results = [
        usnet_env.evaluate(
            "mirrored_swarm:USNET/MultiCluster-v0",
            "lagged-regression(clusters=2)",
            episodes=4,
            env_kwargs={"follow": "test-mirror", "clusters": 2, "uavs": 12, "observation_steps": 60},
            time_limit=limit,
        )
        for limit in (None, 60)
    ]
    assert "mirrored_swarm" in sys.modules
    one, two = ([{k: v for k, v in row.items() if k != "seconds_per_round"} for row in r.rows] for r in results)
    assert one == two
    assert results[0].summary[0]["metrics"]["recall_first"]["mean"] == 1.0
