"""Policies of Stable-Baselines3 in one file of weights."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from detectors.weights import read_arrays, write_weights


def write_policies(path: Path, policies: Mapping[str, Any], training: Mapping[str, Any]) -> None:
    """Write policies by name, without their critics, and beside them the settings of their training."""
    arrays = {
        f"{name}/{key}": part.numpy()
        for name, policy in policies.items()
        for key, part in policy.state_dict().items()
        if not key.startswith(("value_net", "mlp_extractor.value_net", "pi_features", "vf_features"))  # and no copies
    }
    write_weights(path, arrays, training, {})


def read_policies(path: Path) -> dict[str, dict[str, Any]]:
    """The weights of each policy, for its ``load_state_dict`` with ``strict=False``."""
    import torch

    policies: dict[str, dict[str, Any]] = defaultdict(dict)
    for key, array in read_arrays(path).items():
        name, _, name_in_policy = key.partition("/")
        policies[name][name_in_policy] = torch.from_numpy(array)
    return dict(sorted(policies.items()))
