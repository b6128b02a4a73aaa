"""What a training of the reader reads: shards of windows with features and truth, drawn by other processes."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from typing import NamedTuple

import numpy as np
from joblib.externals.loky import get_reusable_executor
from numpy.typing import NDArray

from detectors.reader.examples import Examples
from detectors.reader.features import make_features
from detectors.reader.prior import draw_examples
from usnet_env.arrays import Indices, Mask, Singles

_LARGEST = 60.0  # of a feature of a pair in half precision


class Batch(NamedTuple):
    """B windows of n UAVs each: features, and the truth as :class:`detectors.reader.examples.Examples` has it."""

    pair: NDArray[np.float16]  #: ``(B, n, n, F)``
    uav: Singles  #: ``(B, n, G)``
    context: Singles  #: ``(B, K)``
    head: Mask
    leader: Indices
    root: Indices
    delay: Singles
    family: str


def draw_shard(
    number: int, *, seed: tuple[int, ...], batches: int, windows: int, without: tuple[str, ...], most_uavs: int
) -> list[Batch]:
    """Draw shard ``number`` of a seed: batches, each of one family of the prior, but those in ``without``."""
    rng = np.random.default_rng([*seed, number])
    return [_describe(draw_examples(rng, windows, without=without, most_uavs=most_uavs)) for _ in range(batches)]


def _describe(drawn: Examples) -> Batch:
    tracks = zip(drawn.position, drawn.velocity, drawn.seen, strict=True)
    pair, uav, context = map(np.stack, zip(*(make_features(*window) for window in tracks), strict=True))
    small = np.clip(pair, -_LARGEST, _LARGEST).astype(np.float16)
    return Batch(small, uav, context, drawn.head, drawn.leader, drawn.root, drawn.delay, drawn.family)


def draw_ahead(
    draw: Callable[[int], list[Batch]], numbers: range, workers: int, start: Callable[[], None]
) -> Iterator[list[Batch]]:
    """Yield shards in order while processes, begun by ``start``, draw the next, one each: so memory has a bound."""
    executor = get_reusable_executor(max_workers=workers, timeout=None, initializer=start)
    waiting: deque[Future[list[Batch]]] = deque()
    try:
        for number in numbers:
            waiting.append(executor.submit(draw, number))
            if len(waiting) > workers:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
    finally:
        executor.shutdown(kill_workers=True)
