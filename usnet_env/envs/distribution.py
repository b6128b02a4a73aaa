"""Games that differ: arguments of the swarm that are drawn anew for each episode."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property, partial
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from usnet_env.config import ArgumentError, Config, quote
from usnet_env.swarm import KINEMATICS, SwarmConfig

_MAX_CACHED = 4096  # configurations that are kept, so that equal games of a batch start together

Names = Sequence[str] | Mapping[str, Annotated[float, Field(gt=0)]] | None
Whole = tuple[int, int] | None
MakeConfig = Callable[[dict[str, Any], int | None], SwarmConfig]


class Spread(Config):
    """A number whose logarithm is uniform between those of ``low`` and ``high``, if ``log``, or else the number itself.

    With the probability ``zero`` it is 0 instead.
    """

    low: float
    high: float
    log: bool = False
    zero: Annotated[float, Field(ge=0, le=1)] = 0.0


Numbers = tuple[float, float] | Spread | None
_SPREADS = ("position_noise", "miss_rate", "noise_memory", "miss_burst", "partial_tracks", "swap_rate", "course_noise")


class Distribution(Config):
    """What is drawn for each episode, from the environment's own generator; all draws are independent.

    ``["f1", "f2"]`` are names that are equally likely, ``{"f1": 3, "f2": 1}`` names with weights. ``[2, 6]`` are all
    numbers from the first to the second. The faults of the sensor also take ``{"low": 0.01, "high": 0.1, "log": True,
    "zero": 0.5}``, see :class:`Spread`. What is ``None`` is not drawn. The order of the draws is that of the fields.

    Args:
        version: increases when a draw changes.
        uavs: N of P2; the largest value is that of the arrays, in which indices without a UAV are never alive.
        followers: m of P1, likewise.

    >>> Distribution(follow=["f1", "f2"], uavs=[30, 60]).draw(np.random.default_rng(0))
    {'follow': 'f2', 'uavs': 45}
    """

    version: Literal[1] = 1
    follow: Names = None
    mobility: Names = None
    kinematics: Names = None
    formation: Names = None
    clusters: Whole = None
    decoys: Whole = None
    bystanders: Whole = None
    traffic: Whole = None
    head_jitter: tuple[bool, bool] | None = None
    position_noise: Numbers = None
    miss_rate: Numbers = None
    noise_memory: Numbers = None
    miss_burst: Numbers = None
    partial_tracks: Numbers = None
    swap_rate: Numbers = None
    clutter: Whole = None
    course_noise: Numbers = None
    uavs: Whole = None
    followers: Whole = None

    @model_validator(mode="before")
    @classmethod
    def _make_spreads(cls, values: Any) -> Any:
        rules = dict(values)
        for name, rule in values.items():
            if isinstance(rule, Mapping) and name in _SPREADS:
                try:
                    rules[name] = Spread(**{str(key): value for key, value in rule.items()})
                except ArgumentError as error:
                    raise ArgumentError(f"{name} is no range: {error}") from None
        return rules

    @model_validator(mode="after")
    def _check_order(self) -> Self:
        for name, rule in self.rules.items():
            if not isinstance(rule, Spread) and not len(rule):
                raise ArgumentError(f"{name} must hold at least one name, got {quote(rule)}.")
            low, high = list_extremes(rule)[:2] if _is_range(rule) else (0, 0)
            if low > high or (isinstance(rule, Spread) and rule.log and low <= 0):
                raise ArgumentError(f"{name} must go from a number to a larger one, got {quote(rule)}.")
        return self

    @cached_property
    def rules(self) -> dict[str, Any]:
        """What is drawn, by name."""
        return {name: rule for name, rule in self if name != "version" and rule is not None}

    def draw(self, rng: np.random.Generator) -> dict[str, Any]:
        """Draw the arguments of one swarm."""
        return {name: draw_value(rng) for name, draw_value in self.functions.items()}

    @cached_property
    def functions(self) -> dict[str, Callable[[np.random.Generator], Any]]:
        """What draws each value, by name."""
        return {name: _make_draw(rule) for name, rule in self.rules.items()}


def _is_range(rule: Any) -> bool:
    return isinstance(rule, Spread) or not isinstance(next(iter(rule)), str | bool)


def list_extremes(rule: Any) -> list[Any]:
    """The values of a rule that must be valid, so that all are: both ends of a range, or each name."""
    if isinstance(rule, Spread):
        return [rule.low, rule.high, *[0.0] * (rule.zero > 0)]
    return list(rule)


def _make_draw(rule: Any) -> Callable[[np.random.Generator], Any]:
    """A function that draws a value by a rule."""
    if not _is_range(rule):
        weights = np.array(list(rule.values()) if isinstance(rule, Mapping) else np.ones(len(rule)))
        shares = (weights / weights.sum()).cumsum()
        return partial(_draw_name, list(rule), (shares / shares[-1]).tolist())
    if isinstance(rule, Spread):
        return partial(_draw_spread, rule)
    return partial(_draw_number, *rule)


def _draw_name(names: list[Any], shares: list[float], rng: np.random.Generator) -> Any:
    """What ``rng.choice(names, p=...)`` draws, in a tenth of its time."""
    return names[bisect_right(shares, rng.random())]


def _draw_number(low: Any, high: Any, rng: np.random.Generator) -> float:
    return int(rng.integers(low, high + 1)) if isinstance(low, int) else float(rng.uniform(low, high))


def _draw_spread(rule: Spread, rng: np.random.Generator) -> float:
    low, high = (np.log(rule.low), np.log(rule.high)) if rule.log else (rule.low, rule.high)
    value = float(np.exp(rng.uniform(low, high)) if rule.log else rng.uniform(low, high))
    return value if rng.random() >= rule.zero else 0.0


_LEADERLESS = dict.fromkeys(("shepherd", "reference"), 0.5)  # swarms that no UAV leads
_LED_STRATEGIES = ["unequal_delays", "mixed", "switching", "chain", "pigeons", "cucker_smale", "vicsek"]
_LED_STRATEGIES += ["couzin", "frontness", "part_time", "partial_turns", "predator", "informed"]
_FIELD: dict[str, Any] = {
    "follow": dict.fromkeys(_LED_STRATEGIES, 1.0) | _LEADERLESS,
    "mobility": {"gauss_markov": 3.0, "smooth_turn": 2.0, "waypoint": 2.0, "local_waypoint": 2.0, "iid": 1.0},
    "kinematics": ["unit", "varied_speed", "lagged", "limited", "layered"],
    "clusters": [2, 6],
    "decoys": [0, 2],
    "bystanders": [0, 6],
    "traffic": [0, 6],
    "head_jitter": [True, False],
    "position_noise": {"low": 0.01, "high": 0.1, "log": True, "zero": 0.5},
    "miss_rate": {"low": 0.01, "high": 0.1, "zero": 0.5},
    "noise_memory": {"low": 0.3, "high": 0.9, "zero": 0.5},
    "miss_burst": {"low": 2.0, "high": 6.0, "zero": 0.5},
    "partial_tracks": {"low": 0.05, "high": 0.2, "zero": 0.5},
    "swap_rate": {"low": 0.0002, "high": 0.001, "zero": 0.5},
    "formation": {"gathered": 3.0, "uniform": 1.0},
}
_UNSEEN = {name: f"{name}-led" for name in ("chain", "vicsek", "couzin", "predator", "informed")}

#: The distributions that have a name; `field-led-v1` is for `led_by`, and the last one for P1.
DISTRIBUTIONS = {
    "field-v1": Distribution(**_FIELD),
    "field-led-v1": Distribution(
        **_FIELD | {"follow": {_UNSEEN.get(name, name): share for name, share in _FIELD["follow"].items()}}
    ),
    "cluster-field-v1": Distribution(**_FIELD | {"clusters": None}),
}


class DistributionArguments(Config):
    """The argument about games that differ. A list or mapping for another argument is a part of it."""

    distribution: Distribution | None = Field(
        None, description="what is drawn for each episode: a name, or a mapping of arguments to lists and ranges"
    )

    @model_validator(mode="before")
    @classmethod
    def _gather_rules(cls, values: Any) -> Any:
        base = values.get("distribution")
        rules = DISTRIBUTIONS.get(base, base) if isinstance(base, str) else base
        rules = rules.rules if isinstance(rules, Distribution) else {} if rules is None else rules
        names = [name for name in Distribution.model_fields if name in cls.model_fields]
        if not isinstance(rules, Mapping) or not {*rules} <= {*names, "version"}:
            choices = f"one of {', '.join(DISTRIBUTIONS)}, or a mapping of some of {', '.join(names)}"
            raise ArgumentError(f"distribution must be {choices}, got {quote(base)}.")
        drawn = {name: values[name] for name in names if isinstance(values.get(name), list | tuple | Mapping)}
        rules = {**rules, **drawn}
        fixed = {name: value for name, value in values.items() if name not in drawn}
        fixed = {name: value for name, value in fixed.items() if value is not None or name not in rules}
        return fixed | {"distribution": Distribution(**rules) if rules else None}


class EpisodeSampler:
    """The swarms of an environment: one configuration, or one for each episode.

    Args:
        arguments: what is fixed, and the distribution of the rest; an argument that is given is not drawn.
        make: makes a configuration, in which the given values replace arguments, and whose arrays have a place for so
            many UAVs (``None``: for those that there are).

    Attributes:
        widest: a configuration whose bounds hold for all.
        names: what is drawn.
    """

    def __init__(self, arguments: DistributionArguments, make: MakeConfig) -> None:
        self._make, self._cache = make, dict[Any, SwarmConfig]()
        self.distribution = arguments.distribution or Distribution()
        extremes = {name: list_extremes(rule) for name, rule in self.distribution.rules.items()}
        self.names = tuple(name for name in extremes if name not in arguments.model_fields_set)
        widest = {name: max(extremes[name], key=partial(_measure_width, name)) for name in self.names}
        self.widest = make(widest, None)
        for name in self.names:
            for value in extremes[name]:
                make({**widest, name: value}, self.widest.uavs)

    def draw(self, rng: np.random.Generator) -> SwarmConfig:
        """The swarm of the next episode. All is drawn, so a fixed argument doesn't change the others."""
        if not self.distribution.rules:
            return self.widest
        drawn = self.distribution.draw(rng)
        drawn = {name: drawn[name] for name in self.names}
        key = tuple(drawn.values())
        if key not in self._cache:
            if len(self._cache) == _MAX_CACHED:
                self._cache.clear()
            self._cache[key] = self._make(drawn, self.widest.uavs)
        return self._cache[key]

    def drawn_values(self, config: SwarmConfig) -> dict[str, Any]:
        """What was drawn for a swarm, by name."""
        drawn = {name: getattr(config, name) for name in self.names}
        return drawn | ({"uavs": config.uavs - config.absent} if "uavs" in drawn else {})


def _measure_width(name: str, value: Any) -> Any:
    """How wide the bounds of a value are."""
    if name == "kinematics":
        return KINEMATICS.find(value).top_speed
    return 0 if isinstance(value, str) else value
