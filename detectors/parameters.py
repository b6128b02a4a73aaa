"""Constructors from declared arguments: each argument has its name, type, limits and default in one place."""

from __future__ import annotations

import inspect
import typing
import warnings
from collections import defaultdict
from collections.abc import Callable
from functools import cache
from typing import Annotated, Any, Self, dataclass_transform

from pydantic import Field, create_model

from usnet_env.config import ArgumentError, Config
from usnet_env.window import Window

Count = Annotated[int, Field(ge=1, le=100_000)]  # a number of UAVs, clusters or steps
Lags = Annotated[int, Field(ge=1, le=1000)]  # a number of samples of the past
Seconds = Annotated[float, Field(gt=0, le=1e9)]


@dataclass_transform(eq_default=False)
class Parameters:
    """Base of classes whose constructor stores its keyword arguments under their names and does nothing else.

    A subclass declares its arguments like the fields of a dataclass, and the constructor follows from them::

        class MostCopied(Detector):
            clusters: Annotated[int, Field(ge=1)] = 5

    The arguments of a base class come first. Attributes whose names begin with an underscore, and those of type
    ``ClassVar``, are not arguments. :meth:`check_arguments` checks the values against types and limits. A subclass may
    define ``__init__`` instead; then nothing is checked.

    ``get_params``, ``set_params`` and ``repr`` are those of scikit-learn's ``BaseEstimator``, and
    ``sklearn.base.clone`` works. Scikit-learn itself is not imported: that takes three seconds, in each worker process
    of an evaluation too.
    """

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        inherited = getattr(cls.__init__, "arguments", () if cls.__init__ is object.__init__ else None)
        if "__init__" not in vars(cls) and inherited is not None:
            declared = [
                name
                for name, text in inspect.get_annotations(cls).items()
                if not name.startswith("_") and "ClassVar" not in str(text)
            ]
            setattr(cls, "__init__", _make_constructor(cls, tuple(dict.fromkeys([*inherited, *declared]))))  # noqa: B010  # mypy refuses to assign a method

    def check_arguments(self) -> Any:
        """Check the arguments by their declarations, and return them as a :class:`usnet_env.config.Config`.

        Raises:
            ArgumentError: an argument has another type or is out of its limits.
        """
        kind: Any = type(self)
        config = _make_config(kind)
        return config(**{name: getattr(self, name) for name in config.model_fields})

    @classmethod
    def _signature(cls) -> dict[str, inspect.Parameter]:
        """The constructor's parameters by name, without ``self``, in alphabetical order.

        Raises:
            RuntimeError: the constructor takes any number of positional arguments, which have no names.
        """
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

    def set_params(self, **params: Any) -> Self:
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
        changed = [
            f"{name}={getattr(self, name)!r}"
            for name, parameter in self._signature().items()
            if parameter.default is parameter.empty or repr(getattr(self, name)) != repr(parameter.default)
        ]
        return f"{type(self).__name__}({', '.join(changed)})"


def _make_constructor(owner: type, names: tuple[str, ...]) -> Callable[..., None]:
    """Make the constructor of a class with these arguments."""
    types, kind, empty = _read_types(owner), inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.empty
    parameters = [
        inspect.Parameter(name, kind, default=getattr(owner, name, empty), annotation=types.get(name, Any))
        for name in names
    ]
    taken = inspect.Signature(parameters)

    def __init__(self: Any, *values: Any, **arguments: Any) -> None:
        try:
            bound = taken.bind(*values, **arguments)
        except TypeError as error:
            raise TypeError(f"{type(self).__name__}() {error}") from None
        bound.apply_defaults()
        for name, value in bound.arguments.items():
            setattr(self, name, value)

    __init__.__qualname__, __init__.__module__ = f"{owner.__qualname__}.__init__", owner.__module__
    __init__.arguments = names  # type: ignore[attr-defined]
    first = inspect.Parameter("self", kind)
    __init__.__signature__ = taken.replace(parameters=[first, *parameters], return_annotation=None)  # type: ignore[attr-defined]
    return __init__


def _read_types(owner: Any, limits: bool = False) -> dict[str, Any]:
    """The types of the arguments by name, with their limits if asked for."""
    try:
        return typing.get_type_hints(owner, include_extras=limits)
    except NameError:  # a name that is imported for type checkers only
        return {}


@cache
def _make_config(owner: Any) -> type[Config]:
    """The config that checks the arguments of a class."""
    types = _read_types(owner, limits=True)
    fields: dict[str, Any] = {
        name: (types.get(name, Any), getattr(owner, name, ...)) for name in getattr(owner.__init__, "arguments", ())
    }
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # an argument may have the name of a method of pydantic's
        return create_model(owner.__name__, __base__=Config, **fields)


def count_lags(window: Window, max_lag: int, max_delay: float | None) -> int:
    """The longest delay in samples: ``max_lag``, or as many as ``max_delay`` seconds hold, at least 1.

    Raises:
        ArgumentError: ``max_delay`` is given, and the window doesn't know its step.
    """
    if max_delay is None:
        return max_lag
    if window.step is None:
        raise ArgumentError("max_delay must be None in a window that doesn't know its step, got a simulated one.")
    return max(1, round(min(max_delay / window.step, window.observation_steps)))
