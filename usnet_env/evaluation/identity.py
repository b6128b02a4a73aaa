"""Describe arguments in full as plain values, so that two runs with the same description have the same rows."""

from __future__ import annotations

import hashlib
import inspect
import pickle
import re
from collections.abc import Mapping
from functools import partial
from types import BuiltinFunctionType, FunctionType, MethodType
from typing import Any

import numpy as np
from pydantic import BaseModel

_LARGEST_ARRAY = 64  # values; larger arrays are described by a hash
_DEEPEST = 20  # objects inside objects
_ADDRESS = re.compile(r" at 0x[0-9a-fA-F]+")


def describe(value: Any) -> Any:
    """Describe a value as plain JSON types: equal descriptions mean equal values.

    Numbers, texts, lists and mappings describe themselves. An object is described by its class and its attributes, a
    function by its name and its code, a neural network and a large array by a hash of the numbers.
    """
    return _describe(value, ())


def describe_detector(detector: Any) -> Any:
    """Describe a detector or a policy that takes part in an evaluation.

    A detector is described by its class and the arguments of its constructor, not by what it has counted since. A
    policy is described by a hash of its numbers if it, or its ``policy``, has ``state_dict``.
    """
    name = _name(type(detector))
    if not callable(getattr(detector, "detect", None)):
        network = next((each for each in (detector, getattr(detector, "policy", None)) if _has_state(each)), None)
        if network is not None:  # what else such an agent holds, such as its training environment, does not act
            return {"class": name, "state": _hash_state(network)}
    arguments = {
        argument: getattr(detector, argument)
        for argument, parameter in _parameters(type(detector)).items()
        if parameter.kind not in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD) and hasattr(detector, argument)
    }
    return {"class": name, "arguments": _describe(arguments, (id(detector),))}


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
    if isinstance(value, BaseModel):
        return {name: _describe(getattr(value, name), inner) for name in type(value).model_fields}
    return _describe_object(value, inner)


def _describe_object(value: Any, inner: tuple[int, ...]) -> Any:
    if isinstance(value, type | BuiltinFunctionType):
        return _name(value)
    if isinstance(value, FunctionType):
        return {"function": _name(value), "sha256": _hash_code(value, inner)}
    if isinstance(value, MethodType):
        return {"method": _name(value), "of": _describe(value.__self__, inner)}
    if isinstance(value, partial):
        return {"partial": _describe([value.func, value.args, value.keywords], inner)}
    if isinstance(getattr(value, "py_func", None), FunctionType):  # compiled by Numba
        return _describe(value.py_func, inner)
    description = {"class": _name(type(value))}
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
    code = function.__code__
    constants = [_name_code(each) for each in code.co_consts]
    cells = []
    for cell in function.__closure__ or ():
        try:
            cells.append(_describe(cell.cell_contents, inner))
        except ValueError:  # an empty cell
            cells.append(None)
    defaults = _describe([function.__defaults__, function.__kwdefaults__], inner)
    text = repr((code.co_code, code.co_names, constants, cells, defaults))
    return hashlib.sha256(text.encode("utf-8", "backslashreplace")).hexdigest()


def _name_code(constant: Any) -> Any:
    """A constant of a function, without the address of an inner function."""
    if hasattr(constant, "co_code"):
        return constant.co_code, constant.co_names, [_name_code(each) for each in constant.co_consts]
    return sorted(map(repr, constant)) if isinstance(constant, frozenset) else constant  # sets have no fixed order


def _has_state(value: Any) -> bool:
    return value is not None and not isinstance(value, type) and callable(getattr(value, "state_dict", None))


def _hash_state(network: Any) -> str:
    """Hash the numbers of a network, as PyTorch's modules return them."""
    found = hashlib.sha256()
    for name, tensor in network.state_dict().items():
        found.update(str(name).encode())
        for step in ("detach", "cpu", "float", "numpy"):  # NumPy lacks some of PyTorch's types of numbers
            tensor = getattr(tensor, step, lambda tensor=tensor: tensor)()
        found.update(tensor.tobytes() if isinstance(tensor, np.ndarray) else repr(tensor).encode())
    return found.hexdigest()
