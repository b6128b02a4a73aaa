"""A value of any kind for an argument of a public callable is accepted, or refused in one sentence that names it."""

from __future__ import annotations

import random
import re
from collections import Counter
from contextlib import contextmanager

import pytest
from argument_doors import KINDS, make_doors

from usnet_env import ArgumentError
from usnet_env.registry import REGISTRIES

LONGEST_SENTENCE = 1200  # it may list all arguments or names


@pytest.fixture(autouse=True)
def own_folder(monkeypatch, tmp_path):
    """Keep files with relative names out of the working folder."""
    monkeypatch.chdir(tmp_path)


@contextmanager
def registrations_undone():
    before = {kind: dict(registry.registered) for kind, registry in REGISTRIES.items()}
    try:
        yield
    finally:
        for kind, content in before.items():
            REGISTRIES[kind]._registered = content


@pytest.fixture(scope="module")
def doors(tmp_path_factory):
    return make_doors(tmp_path_factory.mktemp("doors"))


def try_value(door, argument, kind):
    """Call with one value replaced: ``"accepted"``, ``"refused"``, or what is wrong with the refusal."""
    arguments = {**door.valid(), argument: KINDS[kind]()}
    try:
        with registrations_undone():
            door.call(**arguments)
    except ArgumentError as error:
        sentence = str(error)
    except Exception as error:
        return f"{type(error).__name__}: {str(error)[:300]}"
    else:
        return "accepted"
    names = (argument, *door.about.get(argument, ()))
    if not any(re.search(rf"\b{name}\b", sentence) for name in names):
        return f"the argument is not named: {sentence}"
    if "\n" in sentence or not sentence.endswith(".") or len(sentence) > LONGEST_SENTENCE:
        return f"not one sentence: {sentence[:300]}"
    return "refused"


def try_values(doors, count, seed=0):
    """Draw ``count`` different triples of a callable, an argument and a kind of value; return counts and faults."""
    triples = [(name, argument, kind) for name, door in doors.items() for argument in door.valid() for kind in KINDS]
    counts, faults = Counter(), []
    for name, argument, kind in random.Random(seed).sample(triples, count):
        found = try_value(doors[name], argument, kind)
        if found not in ("accepted", "refused"):
            faults.append(f"{name}({argument}={kind}): {found}")
            found = "other"
        counts[found] += 1
    return counts, faults


def test_every_door_accepts_its_valid_arguments(doors):
    for door in doors.values():
        if not door.slow:
            with registrations_undone():
                door.call(**door.valid())


def test_a_sample_of_values_is_accepted_or_refused_in_one_sentence(doors):
    quick = {name: door for name, door in doors.items() if not door.slow}
    counts, faults = try_values(quick, 250)
    assert not faults
    assert counts["refused"] > counts["accepted"] > 0


@pytest.mark.slow
def test_10_000_values_are_accepted_or_refused_in_one_sentence(doors):
    counts, faults = try_values(doors, 10_000)
    print(dict(counts))
    assert not faults, "\n".join(faults)
    assert counts["refused"] > counts["accepted"] > 0


@pytest.mark.parametrize("kind", ["array () int", "integer of 5,001 digits", "object whose repr raises", "1.5"])
def test_the_kinds_are_what_they_say(kind):
    value = KINDS[kind]()
    if "repr raises" in kind or "digits" in kind:
        with pytest.raises((ZeroDivisionError, ValueError)):
            repr(value)
    else:
        assert repr(value) in ("array(6)", "1.5")
