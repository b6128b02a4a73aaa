"""A model that flies differently needs a new version: its episodes are frozen, and the same on every processor."""

import json

import numpy as np
import pytest
from frozen_episodes import FILE, make_entries

ENTRIES = make_entries()


@pytest.mark.parametrize("name", ENTRIES)
def test_the_model_flies_as_its_version_did(name):
    """If it is meant to fly differently, increase its ``version`` and run frozen_episodes.py."""
    frozen = json.loads(FILE.read_text(encoding="utf-8"))[name]
    now = ENTRIES[name]()
    if isinstance(frozen[0], dict):
        for one, other in zip(now, frozen, strict=True):
            assert one == {key: pytest.approx(value) for key, value in other.items()}
    else:
        np.testing.assert_allclose(now, frozen, atol=0.02)


FLIGHT = """
import hashlib
import numpy as np
from usnet_env.swarm import SwarmConfig, advance, start

for follow in ("f5", "pigeons", "vicsek", "couzin", "shepherd"):
    for uavs in (30, 140):  # 140: a flock of 70 UAVs sums in the order of cells
        config = SwarmConfig(follow=follow, clusters=2, uavs=uavs, memory=12, formation="around")
        rngs = [np.random.default_rng(1)]
        state = start(config, rngs)
        for _ in range(2):
            state, window = advance(config, state, rngs)
        bits = window.position.tobytes() + window.velocity.tobytes()
        print(follow, uavs, hashlib.sha256(bits).hexdigest())
"""


@pytest.mark.slow
def test_a_flight_is_the_same_on_a_processor_without_wide_vectors(tmp_path, monkeypatch, fresh_process):
    here = fresh_process.run(FLIGHT)
    plain = {"NUMBA_CPU_NAME": "generic", "NUMBA_CACHE_DIR": str(tmp_path), "NPY_DISABLE_CPU_FEATURES": "X86_V3"}
    for name, value in plain.items():
        monkeypatch.setenv(name, value)
    assert fresh_process.run(FLIGHT) == here
    assert here.count("\n") == 10
