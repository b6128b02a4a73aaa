"""The evaluator: one function that plays all detectors against the same swarms and scores them."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from os import PathLike
from typing import Any

import gymnasium as gym

from usnet_env.config import ArgumentError, named_values, plain_text, quote
from usnet_env.evaluation.agents import PolicyAgent, as_agent
from usnet_env.evaluation.engine import Place, RunArguments, choose_place, play_run
from usnet_env.evaluation.environments import check_labelled, is_usnet, make_environment
from usnet_env.evaluation.identity import describe, describe_code, describe_detector
from usnet_env.evaluation.isolation import make_secret
from usnet_env.evaluation.metrics import TRACK_METRICS
from usnet_env.evaluation.result import EvaluationResult
from usnet_env.evaluation.schedule import Seeds
from usnet_env.evaluation.store import COLUMNS
from usnet_env.evaluation.workers import Worker
from usnet_env.files import as_path
from usnet_env.plugins import detector_label
from usnet_env.processes import Limits

#: The trivial policies that every published table also shows: decision (l) of ``docs/game.md``.
TRIVIAL = ("destroy-all", "none", "random", "one-per-round")


def evaluate(
    env: str | gym.Env[Any, Any],
    detector: Any,
    *,
    episodes: int = 100,
    seed: int = 0,
    env_kwargs: Mapping[str, Any] | None = None,
    workers: int = 1,
    trivial: bool = False,
    out: str | PathLike[str] | None = None,
    progress: bool = False,
    time_limit: float | None = None,
    memory_limit: float | None = None,
    isolate: bool = False,
    secret: str | None = None,
    backend: str | None = None,
    address: str | None = None,
) -> EvaluationResult:
    """Play the same episodes with every detector, and score them.

    The seeds of the swarm and of the detector in episode i come from two separate branches of (``seed``, i), and of the
    secret of an isolated run. So every detector plays against the same swarms, for any number of workers. Each episode
    starts with the detector's ``reset``; the detector receives windows and nothing else. Before its first episode each
    detector answers one window that is neither timed nor scored (warm-up).

    Args:
        env: a registered id, or an environment object (which allows one worker only, and is not closed).
        detector: a name as :func:`usnet_env.make_detector` takes it, a detector, an object with the ``predict`` method
            of Stable-Baselines3 (called with the observation and ``deterministic=True``), a list of these, or a mapping
            of the labels that they get in rows and tables, such as ``{"my PPO": model}``.
        episodes: number of episodes for each detector.
        seed: seed of the whole evaluation.
        env_kwargs: arguments of the environment.
        workers: number of processes; the rows do not depend on it, except for the seconds. A script that uses worker
            processes must call ``evaluate`` in a block that begins with ``if __name__ == "__main__":``, because each
            worker process imports the script.
        trivial: also evaluate the policies of :data:`TRIVIAL`.
        out: folder for ``run.json`` (arguments, versions, machine), ``episodes.csv`` and ``summary.json``. An
            interrupted run keeps its finished episodes there, and the same call plays the remaining ones. A call with
            more episodes or other detectors adds them to the run.
        progress: show a progress bar on standard error.
        time_limit: largest wall time of one answer, or of one ``reset``, in seconds; ``None``: no limit. A detector
            that exceeds it has failed.
        memory_limit: largest memory in megabytes (10^6 bytes) that one answer, or one ``reset``, may allocate;
            ``None``: no limit. Linux only. With one of the two limits, episodes are played in worker processes, also
            if ``workers`` is 1, unless ``isolate`` is true.
        isolate: play each detector in a separate process that never holds an environment and receives windows only.
            All seeds then depend on a secret that is drawn for the run, and written to ``run.json`` and to the
            result's ``config`` when the run ends.
        secret: the secret of an earlier isolated run, to play its episodes again; ``None``: a new one.
        backend: where episodes are played: ``"serial"``, in this process; ``"processes"``, in child processes;
            ``"ray"``, on the nodes of a Ray cluster, one core for each worker. The rows do not depend on it, except for
            the seconds. ``None``: in this process, unless ``workers`` or a limit needs others.
        address: of the Ray cluster, as ``ray.init`` takes it; ``None``: a new one on this machine.

    Returns:
        Rows, summary and tables: of all detectors and episodes that ``out`` holds.

    Raises:
        ArgumentError: an argument was refused.
        EvaluationError: a detector raised an exception, ended its process, exceeded a limit, or its answer has a wrong
            type or shape; the message names the detector, the episode and the cause. The other detectors play to the
            end: the error's ``result`` holds theirs. Finished rows are kept in ``out``.
    """
    folder = None if out is None else as_path("out", out)
    run = RunArguments(
        episodes=episodes, seed=seed, workers=workers, trivial=trivial, progress=progress, isolate=isolate
    )
    seeds = Seeds(run.seed, make_secret(secret), secret is not None) if run.isolate else Seeds(run.seed)
    if secret is not None and not run.isolate:
        raise ArgumentError("secret must be None unless isolate is true, got a secret.")
    limits = _make_limits(time_limit, memory_limit)
    isolation, limits = (limits, Limits()) if run.isolate else (None, limits)
    place = choose_place(backend, run.workers, limits, address)
    arguments = named_values("env_kwargs", env_kwargs)
    detectors = _label_detectors(detector, run)
    with ExitStack() as stack:
        if isinstance(env, str):
            environment = make_environment(env, arguments)
            stack.callback(environment.close)
        else:
            environment = _check_environment(env, arguments, place)
        check_labelled(environment)
        told = arguments if isinstance(env, str) else _find_fixed(environment)
        config = _make_config(environment, told, detectors, run)
        worker = Worker(str(env), arguments, detectors, isolation, environment)
        more = dict.fromkeys(TRACK_METRICS if hasattr(environment.unwrapped, "score_answer") else (), "float | None")
        return play_run(worker, config, seeds, place, folder, run.progress, {**COLUMNS, **more})


def _make_limits(time_limit: float | None, memory_limit: float | None) -> Limits:
    try:
        return Limits(seconds=time_limit, megabytes=memory_limit)
    except ArgumentError as error:
        field, words = str(error).split(" ", 1)
        raise ArgumentError(f"{'time_limit' if field == 'seconds' else 'memory_limit'} {words}") from None


def _check_environment(env: Any, arguments: Mapping[str, Any], place: Place) -> gym.Env[Any, Any]:
    """Check an environment object given by the caller, and return it."""
    if not isinstance(env, gym.Env) or not is_usnet(env):
        raise ArgumentError(f"env must be a registered id or a USNET environment, got {quote(env)}.")
    if arguments:
        raise ArgumentError("env_kwargs must be empty if env is an environment object, got arguments for it.")
    if place.workers != 1:
        raise ArgumentError(f"workers must be 1 if env is an environment object, got {place.workers}.")
    if place.backend not in (None, "serial"):
        raise ArgumentError(f"backend must be None if env is an environment object, got {place.backend!r}.")
    if place.limits.any:
        raise ArgumentError("time_limit and memory_limit must be None if env is an environment object, got a limit.")
    return env


def _label_detectors(detector: Any, run: RunArguments) -> dict[str, Any]:
    """Give each detector its own label."""
    found: dict[str, Any] = {}
    if isinstance(detector, Mapping):
        for label, each in detector.items():
            if not (name := plain_text("label", label)) or not name.isprintable():
                raise ArgumentError(f"label must be a text of printable characters, got {quote(label)}.")
            _make_label(each, run.isolate)  # refuses what is no detector
            found[name] = each
    else:
        for each in list(detector) if isinstance(detector, list | tuple) else [detector]:
            label = first = _make_label(each, run.isolate)
            if label in found and isinstance(each, str):
                raise ArgumentError(f"detector must name each detector once, got {label!r} twice.")
            number = 2
            while label in found:
                label = f"{first} #{number}"
                number += 1
            found[label] = each
    if not found:
        raise ArgumentError(f"detector must name at least one detector, got an empty {type(detector).__name__}.")
    for name in TRIVIAL if run.trivial else ():
        given = found.setdefault(name, name)
        if detector_label(given) != name:
            raise ArgumentError(
                f"label must be another one than {name!r}, the trivial policy, if trivial is true, got it for "
                f"{quote(given)}."
            )
    return found


def _make_label(detector: Any, isolate: bool) -> str:
    """Return the label of a detector; whatever is not a detector is refused.

    With ``isolate``, the code of a detector that is given by name is not loaded here.
    """
    if isolate and isinstance(detector, str):
        return detector_label(detector)
    agent = as_agent(detector)
    return type(detector).__name__ if isinstance(agent, PolicyAgent) else detector_label(detector)


def _find_fixed(environment: gym.Env[Any, Any]) -> dict[str, Any]:
    """The arguments of an environment object that would be drawn in each episode, as far as its id does not set them.

    No other argument is needed to identify an environment object: its config and its rules show them.
    """
    found: Mapping[str, Any] = getattr(environment.unwrapped, "drawn_arguments", {})
    registered = gym.registry.get(environment.spec.id) if environment.spec else None
    own = registered.kwargs if registered else {}
    return {name: value for name, value in found.items() if value != own.get(name)}


def _make_config(
    environment: gym.Env[Any, Any], arguments: Mapping[str, Any], detectors: Mapping[str, Any], run: RunArguments
) -> dict[str, Any]:
    """Return the arguments of the run as plain values: runs with the same config have the same rows."""
    inner: Any = environment.unwrapped
    settings = {name: describe(getattr(inner, name)) for name in ("config", "rules") if hasattr(inner, name)}
    if hasattr(inner, "widest_config"):  # its config is that of the last episode
        settings["config"] = describe(inner.widest_config)
    recording = {"recording": inner.recording} if hasattr(inner, "recording") else {}  # SHA-256 of its content
    return {
        "env": type(inner).__name__ if environment.spec is None else environment.spec.id,
        "env_kwargs": describe(arguments),
        "environment": settings,
        **recording,
        **describe_code(type(inner), settings),
        "detectors": list(detectors),
        "identities": [describe_detector(each) for each in detectors.values()],
        "episodes": run.episodes,
        "seed": run.seed,
        **({"isolate": True} if run.isolate else {}),
    }
