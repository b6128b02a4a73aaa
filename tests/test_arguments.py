"""A value of any kind for an argument of a public callable is accepted, or refused in one sentence with its name."""

from __future__ import annotations

import os
import random
import re
from collections import Counter
from pathlib import Path
from unittest import mock

import pytest
from argument_doors import KINDS, make_doors

import usnet_env.plugins
from detectors.clustering import base as clusterers
from usnet_env import ArgumentError
from usnet_env.multiagent import fusion
from usnet_env.swarm import follow, mobility

REGISTRIES = (
    (follow, "_STRATEGIES"),
    (mobility, "_MOBILITIES"),
    (fusion, "_FUSIONS"),
    (usnet_env.plugins, "_registered"),
    (clusterers, "_CLUSTERERS"),
)


def find_fault(door, argument, kind):
    """Try one value: ``"accepted"``, ``"refused"``, or what is wrong with the answer."""
    arguments = {**door.valid(), argument: KINDS[kind]()}
    try:
        door.call(**arguments)
    except ArgumentError as error:
        sentence = str(error)
    except Exception as error:
        return f"{type(error).__name__}: {str(error)[:300]}"
    else:
        return "accepted"
    names = (argument, *door.about.get(argument, ()))
    if not any(re.search(rf"\b{name}\b", sentence) for name in names):
        return f"does not name the argument: {sentence}"
    if "\n" in sentence or not sentence.endswith(".") or len(sentence) > 1200:
        return f"not one sentence: {sentence[:300]}"
    return "refused"


def run_tries(folder, count, slow):
    """Draw ``count`` triples of a callable, an argument and a kind; return the counts and the faults."""
    doors = make_doors(folder)
    triples = [
        (name, argument, kind)
        for name, door in doors.items()
        if slow or not door.slow
        for argument in door.valid()
        for kind in KINDS
    ]
    counts, faults = Counter(), []
    for name, argument, kind in random.Random(0).sample(triples, min(count, len(triples))):
        with mock.patch.multiple("builtins"), _registries():
            found = find_fault(doors[name], argument, kind)
        if found in ("accepted", "refused"):
            counts[found] += 1
        else:
            counts["other"] += 1
            faults.append(f"{name}({argument}={kind}): {found}")
    return counts, faults
