"""Describe arguments in full as plain values, so that two runs with the same description have the same rows."""

from __future__ import annotations

import hashlib
import inspect
import json
import pickle
import re
import sys
from collections.abc import Iterator, Mapping
from contextlib import suppress
from functools import partial
from pathlib import PurePath
from types import BuiltinFunctionType, FunctionType, MethodType, ModuleType
from typing import Any

import gymnasium as gym
import numpy as np
from pydantic import BaseModel

from usnet_env.config import quote
from usnet_env.evaluation.sources import VERSIONED, code_text, hash_code, hash_named_code
from usnet_env.parts import OWN_DISTRIBUTION, REGISTRIES, format_label, parse_label

_LARGEST_ARRAY = 64  # values; larger arrays are described by a hash
_DEEPEST = 20  # objects inside objects
_FIRST = ("class", "name")  # keys of a description; without these in common, others do not matter
_ADDRESS = re.compile(r" at 0x[0-9a-fA-F]+")


def describe(value: Any) -> Any:
    """Describe a value as plain JSON types: equal descriptions mean equal values.

    Numbers, texts, lists and mappings describe themselves. An object is described by its class and its attributes, a
    function by its name and its code, a neural network and a large array by a hash of the numbers.
    """
    return _describe(value, ())


def describe_detector(detector: Any) -> Any:
    """Describe a detector or a policy that takes part in an evaluation.

    A name is described by itself and by the code behind it, an object by its class, the code of the class and the
    arguments of its constructor, not by what it has counted since. A policy that is no detector is also described by
    its numbers: those of its ``state_dict``, or else all arrays and real numbers that it holds.
    """
    if isinstance(detector, str):
        plain, given = parse_label(detector, {})
        parts = describe_parts(plain, given)
        return {"name": format_label(plain, given), "parts": parts} if parts else format_label(plain, given)
    description = _describe_class(type(detector))
    above = (id(detector),)
    if not callable(getattr(detector, "detect", None)):
        network = next((each for each in (detector, getattr(detector, "policy", None)) if _has_state(each)), None)
        if network is not None:  # what else such an agent holds, such as its training environment, does not act
            return description | {"state": _hash_state(network)}
        versioned = type(detector).__module__.partition(".")[0] in VERSIONED
        if not versioned and (numbers := _find_numbers(detector, ())) is not None:
            text = json.dumps(numbers, sort_keys=True)
            description |= {"state": hashlib.sha256(text.encode()).hexdigest()}
    arguments = {
        argument: getattr(detector, argument)
        for argument, parameter in _parameters(type(detector)).items()
        if parameter.kind not in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD) and hasattr(detector, argument)
    }
    parts = describe_parts(arguments)
    return description | {"arguments": _describe(arguments, above)} | ({"parts": parts} if parts else {})


def describe_parts(*values: Any) -> dict[str, Any]:
    """Describe what plain values name: ``module:Class``, and parts that are registered or installed by others.

    Args:
        values: texts, and mappings and lists of them; anything else is no name.

    Returns:
        By the kind and the name of a part, its code; the version of an installed distribution instead of its code.
    """
    texts = set(_texts(values))
    names = texts | {text.partition("(")[0].strip() for text in texts}
    found: dict[str, Any] = {}
    for kind, registry in REGISTRIES.items():
        for name in sorted(names & registry.registered.keys()):
            found[f"{kind} {name!r}"] = describe(registry.registered[name])
        points = registry.entry_points() if names else {}
        for name in sorted((names & points.keys()) - registry.registered.keys()):
            point = points[name]
            if code := hash_named_code(point.module, point.attr):
                found[f"{kind} {name!r}"] = code
            elif point.dist is not None and point.dist.name != OWN_DISTRIBUTION:
                found[f"{kind} {name!r}"] = f"{point.dist.name} {point.dist.version}"
    for name in sorted(name for name in names if ":" in name):
        module, _, path = name.partition(":")
        if code := hash_named_code(module, path):
            found[f"detector {name!r}"] = code
    return found


def describe_code(kind: type, settings: Any) -> dict[str, Any]:
    """The code of an environment and of the parts that its settings name, by what it is; empty for this package."""
    code = hash_code(kind)
    found = ({f"environment {kind.__qualname__!r}": code} if code else {}) | describe_parts(settings)
    return {"code": found} if found else {}


def describe_difference(there: Any, asked: Any) -> str:
    """Say how a detector or a team of a run differs from the one of the same label that joins it.

    Args:
        there: its description in the run.
        asked: its description now.

    Returns:
        The end of a sentence, such as ``has other code``.
    """
    if isinstance(there, list) and isinstance(asked, list) and len(there) == len(asked):
        return next(describe_difference(*pair) for pair in zip(there, asked, strict=True) if pair[0] != pair[1])
    if not isinstance(there, dict) or not isinstance(asked, dict):
        return f"is {quote(there)} instead of {quote(asked)}"
    key = min(differing_keys(there, asked), key=lambda key: (key not in _FIRST, key))
    old, new = there.get(key), asked.get(key)
    if key in _FIRST:
        return f"is {quote(old)} instead of {quote(new)}"
    if key in ("code", "parts"):
        names = "" if key == "code" else f" of {' and '.join(differing_keys(old, new))}"
        return f"has other code{names}" if old else f"has code{names} that the run does not describe"
    if key == "arguments":
        first = differing_keys(old, new)[0]
        return f"has {first} = {quote((old or {}).get(first))} instead of {quote((new or {}).get(first))}"
    return "has other weights" if key == "state" else f"has a policy for {key} that {describe_difference(old, new)}"


def differing_keys(one: Any, other: Any) -> list[str]:
    """The keys whose values differ in two mappings, one of which may be missing."""
    first, second = one or {}, other or {}
    return sorted(key for key in first.keys() | second.keys() if first.get(key) != second.get(key))


def _texts(value: Any) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    elif isinstance(value, Mapping | list | tuple):
        for each in value.values() if isinstance(value, Mapping) else value:
            yield from _texts(each)


def _find_numbers(value: Any, above: tuple[int, ...]) -> Any:
    """The arrays and real numbers that a policy holds, which training changes; ``None`` without any.

    Whole numbers, texts and generators are left out, because they change while the policy acts; an environment and a
    space do not act.
    """
    inert: Any = (gym.Env, gym.spaces.Space, type, ModuleType)
    if id(value) in above or len(above) > _DEEPEST or isinstance(value, inert):
        return None
    inner = (*above, id(value))
    if isinstance(value, float | np.floating | np.ndarray | FunctionType):
        return _describe(value, above)
    if value is None or isinstance(value, int | str | bytes | np.generic):
        return None
    if _has_state(value):
        return _hash_state(value)
    if callable(getattr(value, "detect", None)):
        return describe_detector(value)
    if callable(getattr(value, "detach", None)):
        return _describe(_to_array(value), inner)
    if isinstance(value, Mapping | list | tuple) or hasattr(value, "__dict__"):
        items = dict(enumerate(value)) if isinstance(value, list | tuple) else value
        items = items if isinstance(items, Mapping) else vars(items)
        found = {str(name): _find_numbers(each, inner) for name, each in items.items()}
        return {name: each for name, each in found.items() if each is not None} or None
    home = type(value).__module__
    if home.partition(".")[0] in sys.stdlib_module_names or home.startswith("numpy"):
        return None
    with suppress(Exception):  # an object written in C, such as a tree of scikit-learn
        return hashlib.sha256(pickle.dumps(value)).hexdigest()
    return None


def _describe_class(kind: type) -> dict[str, Any]:
    code = hash_code(kind)
    return {"class": _name(kind)} | ({"code": code} if code else {})


def _describe(value: Any, above: tuple[int, ...]) -> Any:
    if value is None or isinstance(value, str | bool | int | float):
        return value
    if id(value) in above or len(above) > _DEEPEST:
        return _name(type(value))
    inner = (*above, id(value))
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray):
        if value.size <= _LARGEST_ARRAY and value.dtype.kind in "biuf":
            return value.tolist()
        data = pickle.dumps(value) if value.dtype.hasobject else value.tobytes()
        return {"array": f"{value.dtype} {value.shape}", "sha256": hashlib.sha256(data).hexdigest()}
    if isinstance(value, Mapping):
        return {str(name): _describe(item, inner) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [_describe(item, inner) for item in value]
    if isinstance(value, set | frozenset):
        return sorted((_describe(item, inner) for item in value), key=repr)
    if isinstance(value, PurePath):
        return str(value)
    if isinstance(value, BaseModel):
        return {name: _describe(getattr(value, name), inner) for name in type(value).model_fields}
    return _describe_object(value, inner)


def _describe_object(value: Any, inner: tuple[int, ...]) -> Any:
    if isinstance(value, type):
        own = _describe_class(value)
        return own if "code" in own else own["class"]
    if isinstance(value, BuiltinFunctionType):
        return _name(value)
    if isinstance(value, FunctionType):
        uses = hash_code(value)
        return {"function": _name(value), "sha256": _hash_code(value, inner)} | ({"code": uses} if uses else {})
    if isinstance(value, MethodType):
        return {"method": _name(value), "of": _describe(value.__self__, inner)}
    if isinstance(value, partial):
        return {"partial": _describe([value.func, value.args, value.keywords], inner)}
    if isinstance(getattr(value, "py_func", None), FunctionType):  # compiled by Numba
        return _describe(value.py_func, inner)
    if callable(getattr(value, "detect", None)):
        return describe_detector(value)
    description = _describe_class(type(value))
    if _has_state(value):
        return description | {"state": _hash_state(value)}
    if hasattr(value, "__dict__"):
        return description | {"attributes": _describe(vars(value), inner)}
    text = repr(value)
    return description | {"value": text if not _ADDRESS.search(text) else ""}


def _name(value: Any) -> str:
    return f"{getattr(value, '__module__', '')}:{getattr(value, '__qualname__', type(value).__qualname__)}"


def _parameters(factory: Any) -> Mapping[str, inspect.Parameter]:
    try:
        return inspect.signature(factory).parameters
    except (TypeError, ValueError):
        return {}


def _hash_code(function: FunctionType, inner: tuple[int, ...]) -> str:
    """Hash what a function computes: its code, its constants, its defaults and the values that it closes over."""
    cells = []
    for cell in function.__closure__ or ():
        try:
            cells.append(_describe(cell.cell_contents, inner))
        except ValueError:  # an empty cell
            cells.append(None)
    defaults = _describe([function.__defaults__, function.__kwdefaults__], inner)
    text = repr((code_text(function.__code__), cells, defaults))
    return hashlib.sha256(text.encode("utf-8", "backslashreplace")).hexdigest()


def _has_state(value: Any) -> bool:
    return value is not None and not isinstance(value, type) and callable(getattr(value, "state_dict", None))


def _hash_state(network: Any) -> str:
    """Hash the numbers of a network, as PyTorch's modules return them."""
    found = hashlib.sha256()
    for name, tensor in network.state_dict().items():
        found.update(str(name).encode())
        tensor = _to_array(tensor)
        found.update(tensor.tobytes() if isinstance(tensor, np.ndarray) else repr(tensor).encode())
    return found.hexdigest()


def _to_array(tensor: Any) -> Any:
    """An array of a tensor of PyTorch; anything else as it is."""
    for step in ("detach", "cpu", "float", "numpy"):  # NumPy lacks some of PyTorch's types of numbers
        tensor = getattr(tensor, step, lambda tensor=tensor: tensor)()
    return tensor
