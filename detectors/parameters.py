"""The constructor's arguments of an object as parameters that can be read, changed and shown."""

from __future__ import annotations

import inspect
from collections import defaultdict
from typing import Any, TypeVar

__all__ = ["Parameters"]

Self = TypeVar("Self", bound="Parameters")


class Parameters:
    """Base of classes whose constructor stores its keyword arguments under their names and does nothing else.

    ``get_params``, ``set_params`` and ``repr`` are those of scikit-learn's ``BaseEstimator``, and
    ``sklearn.base.clone`` works. Scikit-learn itself is not imported: that takes three seconds, in each worker process
    of an evaluation too.
    """

    @classmethod
    def _signature(cls) -> dict[str, inspect.Parameter]:
        """The constructor's parameters by name, without ``self``, in alphabetical order.

        Raises:
            RuntimeError: the constructor takes any number of positional arguments, which have no names.
        """
        if cls.__init__ is object.__init__:
            return {}
        _, *parameters = inspect.signature(cls.__init__).parameters.values()
        if any(parameter.kind is parameter.VAR_POSITIONAL for parameter in parameters):
            raise RuntimeError(f"the constructor of {cls.__name__} must name its arguments, got one with *arguments.")
        named = [parameter for parameter in parameters if parameter.kind is not parameter.VAR_KEYWORD]
        return {parameter.name: parameter for parameter in sorted(named, key=lambda each: each.name)}

    def get_params(self, deep: bool = True) -> dict[str, Any]:
        """Return the arguments by name.

        Args:
            deep: whether to add the parameters of each argument that has parameters, as ``<argument>__<parameter>``.
        """
        found: dict[str, Any] = {}
        for name in self._signature():
            value = getattr(self, name)
            if deep and hasattr(value, "get_params") and not isinstance(value, type):
                found |= {f"{name}__{inner}": each for inner, each in value.get_params().items()}
            found[name] = value
        return found

    def set_params(self: Self, **params: Any) -> Self:
        """Change arguments, given by name; ``<argument>__<parameter>`` changes a parameter of an argument.

        Returns:
            This object.

        Raises:
            ValueError: a name is unknown.
        """
        inner: defaultdict[str, dict[str, Any]] = defaultdict(dict)
        known = self._signature()
        for name, value in params.items():
            first, nested, rest = name.partition("__")
            if first not in known:
                raise ValueError(
                    f"Invalid parameter {first!r} for estimator {self}. Valid parameters are: {list(known)}."
                )
            if nested:
                inner[first][rest] = value
            else:
                setattr(self, first, value)
        for first, values in inner.items():
            getattr(self, first).set_params(**values)
        return self

    def __repr__(self) -> str:
        """The class with all arguments that differ from their defaults."""
        given = {name: repr(getattr(self, name)) for name in self._signature()}
        changed = [
            f"{name}={given[name]}"
            for name, parameter in self._signature().items()
            if parameter.default is parameter.empty or given[name] != repr(parameter.default)
        ]
        return f"{type(self).__name__}({', '.join(changed)})"
