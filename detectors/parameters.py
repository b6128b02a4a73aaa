"""Constructors from declared arguments: each argument has its name, type, limits and default in one place."""

from __future__ import annotations

import inspect
import typing
import warnings
from dataclasses import MISSING, dataclass, fields
from functools import cache
from typing import Annotated, Any, ClassVar, Self, dataclass_transform

import numpy as np
from pydantic import Field, create_model

from usnet_env.config import Config
from usnet_env.config import Count as Count  # for the detectors

Lags = Annotated[int, Field(ge=1, le=1000)]  # a number of samples of the past


@dataclass_transform(eq_default=False)
class Parameters:
    """Base of classes whose constructor stores its arguments under their names and does nothing else.

    A subclass is a dataclass without being decorated; its arguments are its fields::

        class MostCopied(Detector):
            clusters: Annotated[int, Field(ge=1)] = 5

    :meth:`check_arguments` checks the values against types and limits. A subclass may define ``__init__`` instead; then
    nothing is checked. ``sklearn.base.clone`` works without importing scikit-learn, which takes seconds.
    """

    _declared: ClassVar[bool] = True  # whether the constructor follows from the fields

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        cls._declared = cls._declared and "__init__" not in vars(cls)
        if cls._declared:
            dataclass(eq=False, repr=False)(cls)

    def check_arguments(self) -> Any:
        """Check the arguments by their declarations, and return them as a :class:`usnet_env.config.Config`.

        Raises:
            ArgumentError: an argument has another type or is out of its limits.
        """
        kind: Any = type(self)
        config = _make_config(kind)
        checked = config(**{name: getattr(self, name) for name in config.model_fields})
        plain = {name: value for name, value in checked if isinstance(getattr(self, name), np.generic)}
        vars(self).update(plain)  # NumPy computes otherwise with its own numbers: -np.uint8(3) is 253
        return checked

    def get_params(self, deep: bool = True) -> dict[str, Any]:
        """Return the arguments by name; ``deep`` has no effect, since no argument has parameters."""
        return {name: getattr(self, name) for name in sorted(inspect.signature(type(self)).parameters)}

    def set_params(self, **params: Any) -> Self:
        """Change arguments, given by name, and return this object; an unknown name is a ``ValueError``."""
        known = self.get_params()
        for name, value in params.items():
            if name not in known:
                raise ValueError(f"Invalid parameter {name!r} for {self}. Valid parameters are: {list(known)}.")
            setattr(self, name, value)
        return self

    def __repr__(self) -> str:
        """The class with all arguments that differ from their defaults."""
        declared = inspect.signature(type(self)).parameters
        changed = [f"{k}={v!r}" for k, v in self.get_params().items() if repr(v) != repr(declared[k].default)]
        return f"{type(self).__name__}({', '.join(changed)})"


@cache
def _make_config(owner: Any) -> type[Config]:
    """The config that checks the arguments of a class."""
    if not owner._declared:
        return Config
    types = typing.get_type_hints(owner, include_extras=True)
    declared: dict[str, Any] = {
        field.name: (types[field.name], ... if field.default is MISSING else field.default) for field in fields(owner)
    }
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # an argument may have the name of a method of pydantic's
        return create_model(owner.__name__, __base__=Config, **declared)
