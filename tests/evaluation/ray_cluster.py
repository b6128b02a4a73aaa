"""Evaluate on a local Ray cluster of two nodes, and kill what the argument names in mid-run; prints what happened.

python ray_cluster.py FOLDER nothing|worker|node
"""

from __future__ import annotations

import json
import os
import signal
import sys
import threading
import time
from pathlib import Path

from usnet_env import evaluate

MULTI = "USNET/MultiCluster-v0"
ASKED = {
    "episodes": 12,
    "seed": 3,
    "env_kwargs": {"clusters": 3, "uavs": 20, "observation_steps": 20, "max_rounds": 5},
}
DETECTORS = ["sample_detectors:Mortal", "random"]


def find_actors():
    """Processes of Ray that run the workers of a run."""
    found = []
    for line in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            if b"ray::_Actor" in line.read_bytes():
                found.append(int(line.parent.name))
        except OSError:  # it has just ended
            continue
    return found


def count_rows(folder):
    try:
        return len((folder / "episodes.csv").read_text().splitlines()) - 1
    except OSError:
        return 0


def main(folder, what):
    from ray.cluster_utils import Cluster

    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 0, "include_dashboard": False})
    nodes = [cluster.add_node(num_cpus=1) for _ in range(2)]
    cluster.wait_for_nodes()
    kept = []

    def disturb():
        while count_rows(folder) < 4:
            time.sleep(0.05)
        kept.append(count_rows(folder))
        if what == "worker":
            os.kill(find_actors()[0], signal.SIGKILL)
        elif what == "node":
            cluster.remove_node(nodes[0], allow_graceful=False)

    thread = threading.Thread(target=disturb, daemon=True)
    thread.start()
    result = evaluate(MULTI, DETECTORS, workers=2, backend="ray", address=cluster.address, out=folder, **ASKED)
    thread.join(5)
    print(json.dumps({"rows": list(result.rows), "kept": kept, "in_file": count_rows(folder)}))
    cluster.shutdown()


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2])
