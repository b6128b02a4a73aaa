"""Wraps a policy as a detector."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from functools import cached_property
from importlib import import_module
from typing import Any

import numpy as np
from gymnasium import spaces

from detectors.base import Detector
from usnet_env.arrays import Floats, Mask, Observation
from usnet_env.config import ArgumentError, quote
from usnet_env.detection import Detection
from usnet_env.window import Window

_SCORES = ("logits", "probs", "probability", "loc", "scores")  # keys under which actors of TorchRL store scores


def observation_of(window: Window) -> Observation:
    """Convert a window to the observation of an environment, with ``step`` ``(1,)`` seconds for recorded tracks."""
    numbers = {"round": window.round} if window.step is None else {"round": window.round, "step": window.step}
    return {
        "position": window.position.copy(),
        "velocity": window.velocity.copy(),
        "seen": window.seen.astype(np.int8),
        "alive": window.alive.astype(np.int8),
        **{name: np.array([value], np.float32) for name, value in numbers.items()},
    }


class PolicyDetector(Detector):
    """A policy of Stable-Baselines3 or TorchRL, or a PyTorch module, as a detector that acts deterministically.

    The attributes of the policy decide which of three interfaces is used:

    * ``predict(observation, state, episode_start, deterministic)`` (Stable-Baselines3): a binary action ``(N,)`` marks
      the candidates, an integer is the index of the only one. Scores are the probabilities of ``get_distribution``, if
      there is one, or the action. ``action_masks`` are passed if it takes them.
    * ``in_keys`` and ``out_keys`` (TorchRL): called with a ``TensorDict``; ``"action"`` is read as above, and scores
      come from ``"logits"``, ``"probs"``, ``"probability"``, ``"loc"`` or ``"scores"``.
    * any other callable, such as a ``torch.nn.Module``: it is called with the observation as tensors with a leading
      axis of length 1 and returns N scores; UAVs with a score above ``threshold`` are candidates.

    Args:
        policy: the policy: ``model.policy`` of a Stable-Baselines3 model, not the model with its environment.
        observe: function that converts a window to the observation of a policy that was trained in a wrapped
            environment; ``None``: the parts of :func:`observation_of` that its ``observation_space`` has.
        threshold: threshold on the scores for the third interface: 0 for logits, 0.5 for probabilities.

    Raises:
        ArgumentError: from :meth:`reset` and :meth:`detect`: the policy has none of these interfaces, or returns a
            number of values other than N.
    """

    policy: Any
    observe: Callable[[Window], Any] | None = None
    threshold: float = 0.0

    @cached_property
    def _memory(self) -> tuple[Any, bool]:
        """The state of the policy, ``None`` at the start of an episode; whether the next window is the first of it."""
        return None, True

    def check_arguments(self) -> Any:
        """Check the policy and the other arguments."""
        policy = self.policy
        if isinstance(policy, type) or not (callable(policy) or callable(getattr(policy, "predict", None))):
            raise ArgumentError(
                f"policy must have predict(observation, ...) or be a TorchRL or PyTorch module, got {quote(policy)}."
            )
        if any(getattr(policy, name, None) is not None for name in ("env", "_vec_normalize_env")):
            raise ArgumentError("policy must hold no environment: pass model.policy, not a Stable-Baselines3 model.")
        return super().check_arguments()

    def detect(self, window: Window) -> Detection:
        """Return the policy's deterministic action on the window as a detection."""
        observation: Any = observation_of(window) if self.observe is None else self.observe(window)
        space = getattr(self.policy, "observation_space", None)
        if self.observe is None and isinstance(space, spaces.Dict):
            observation = {name: observation[name] for name in space.spaces if name in observation}
        if callable(getattr(self.policy, "predict", None)):
            candidates, scores = self._act_by_predict(observation, window)
        elif hasattr(self.policy, "in_keys") and hasattr(self.policy, "out_keys"):
            candidates, scores = self._act_by_tensordict(observation, window)
        else:
            scores = _to_scores(self._call_policy(_to_tensors(observation, self.policy)), window.uavs)
            candidates = scores > self.threshold
        return Detection(candidates=candidates & window.alive, scores=scores)

    def _act_by_predict(self, observation: Any, window: Window) -> tuple[Mask, Floats]:
        predict, masks = self.policy.predict, {}
        if "action_masks" in inspect.signature(predict).parameters:
            masks = {"action_masks": np.stack([np.ones(window.uavs, bool), window.alive], axis=1).ravel()}
        state, first = self._memory
        action, state = predict(observation, state=state, episode_start=np.array([first]), deterministic=True, **masks)
        self._memory = state, False
        candidates = _to_candidates(action, window.uavs)
        scores = self._read_probabilities(observation, window.uavs)
        return candidates, candidates.astype(np.float64) if scores is None else scores

    def _read_probabilities(self, observation: Any, uavs: int) -> Floats | None:
        """Probability per UAV from Stable-Baselines3's action distribution; ``None`` if the policy offers none."""
        policy, get = self.policy, getattr(self.policy, "get_distribution", None)
        if get is None or not hasattr(policy, "obs_to_tensor") or "lstm_states" in inspect.signature(get).parameters:
            return None  # a recurrent policy needs more than one observation
        torch = import_module("torch")
        with torch.no_grad():
            distribution = get(policy.obs_to_tensor(observation)[0])
        base = getattr(distribution, "distribution", None) or getattr(distribution, "distributions", None)
        if isinstance(base, list) and all(part.probs.shape == (1, 2) for part in base):
            return _to_scores(torch.cat([part.probs[:, 1] for part in base]), uavs)  # MultiDiscrete([2] * N), masked
        probabilities = getattr(base, "probs", None)
        return None if probabilities is None or probabilities.numel() != uavs else _to_scores(probabilities, uavs)

    def _act_by_tensordict(self, observation: Any, window: Window) -> tuple[Mask, Floats]:
        tensordict = import_module("tensordict")  # installed wherever such a policy exists
        inputs = tensordict.TensorDict(_to_tensors(observation, self.policy), batch_size=[1])
        with import_module("tensordict.nn").set_interaction_type("deterministic"):
            outputs = self._call_policy(inputs)
        candidates = _to_candidates(outputs.get("action"), window.uavs)
        values = (outputs.get(key, None) for key in _SCORES)
        scores = next((value for value in values if value is not None and value.numel() == window.uavs), candidates)
        return candidates, _to_scores(scores, window.uavs)

    def _call_policy(self, inputs: Any) -> Any:
        """Call the policy without gradients and in evaluation mode; restore the training mode at the end."""
        training = [module for module in getattr(self.policy, "modules", list)() if module.training]
        for module in training:
            module.training = False
        try:
            with import_module("torch").no_grad():
                return self.policy(inputs)
        finally:
            for module in training:
                module.training = True


def _to_tensors(observation: Any, policy: Any) -> Any:
    """An observation, a mapping of arrays or one array, as tensors with a leading axis on the policy's device."""
    if isinstance(observation, dict):
        return {name: _to_tensors(value, policy) for name, value in observation.items()}
    weight = next(iter(getattr(policy, "parameters", list)()), None)
    device = "cpu" if weight is None else weight.device
    return import_module("torch").as_tensor(np.asarray(observation), device=device)[None]


def _to_scores(value: Any, uavs: int) -> Floats:
    """N numbers, possibly with axes of length 1, as an array ``(N,)``."""
    values = np.asarray(value.detach().cpu() if hasattr(value, "detach") else value)
    if values.size != uavs or values.dtype.kind not in "biuf":
        raise ArgumentError(f"policy must give one number for each of {uavs} UAVs, got shape {values.shape}.")
    return values.reshape(uavs).astype(np.float64)


def _to_candidates(action: Any, uavs: int) -> Mask:
    """An action, N zeros and ones or the index of one UAV, as candidates ``(N,)``."""
    values = np.asarray(action.detach().cpu() if hasattr(action, "detach") else action)
    if values.size == 1 and uavs > 1 and values.dtype.kind in "iu" and 0 <= values.item() < uavs:
        return np.arange(uavs) == values.item()
    bits = _to_scores(values, uavs)
    if not np.isin(bits, (0, 1)).all():
        raise ArgumentError(f"policy must give an action of 0 and 1, got {quote(values)}.")
    return bits.astype(bool)
