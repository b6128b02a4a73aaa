"""What a training of the reader reads: shards of windows with features and truth, drawn by other processes."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from typing import NamedTuple

import numpy as np
from joblib.externals.loky import get_reusable_executor
from numpy.typing import NDArray

from detectors.reader.features import make_features
from detectors.reader.prior import draw_examples
from usnet_env.arrays import Indices, Mask, Singles

_LARGEST = 60.0  # of a feature of a pair in half precision
_LONGEST_WAIT = 3600  # seconds that a process without work stays


class Batch(NamedTuple):
    """B windows of n UAVs each: features, and the truth as :class:`detectors.reader.examples.Examples` has it."""

    pair: NDArray[np.float16]  #: ``(B, n, n, F)``
    uav: Singles  #: ``(B, n, G)``
    context: Singles  #: ``(B, K)``
    head: Mask  #: ``(B, n)``
    leader: Indices  #: ``(B, n)``
    root: Indices  #: ``(B, n)``
    delay: Singles  #: ``(B, n)``
    family: str


class Shards(NamedTuple):
    """What determines the shards: shard k is drawn from ``(*seed, k)``.

    Args:
        seed: the entropy that all shards share.
        batches, windows: batches in a shard, and windows in a batch.
        without: names of the families that are left out.
        most_uavs: the largest N.
    """

    seed: tuple[int, ...]
    batches: int
    windows: int
    without: tuple[str, ...]
    most_uavs: int

    def draw(self, number: int) -> list[Batch]:
        """Draw a shard."""
        rng = np.random.default_rng([*self.seed, number])
        return [self._draw_batch(rng) for _ in range(self.batches)]

    def _draw_batch(self, rng: np.random.Generator) -> Batch:
        drawn = draw_examples(rng, self.windows, without=self.without, most_uavs=self.most_uavs)
        tracks = zip(drawn.position, drawn.velocity, drawn.seen, strict=True)
        pair, uav, context = map(np.stack, zip(*(make_features(*window) for window in tracks), strict=True))
        small = np.clip(pair, -_LARGEST, _LARGEST).astype(np.float16)
        return Batch(small, uav, context, drawn.head, drawn.leader, drawn.root, drawn.delay, drawn.family)


def draw_ahead(
    draw: Callable[[int], list[Batch]], numbers: range, workers: int, initialiser: Callable[[], None]
) -> Iterator[list[Batch]]:
    """Yield shards in order, while ``workers`` processes draw the next ones: one each, so that memory has a bound."""
    executor = get_reusable_executor(max_workers=workers, timeout=_LONGEST_WAIT, initializer=initialiser)
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
