"""What a training of the reader reads: shards of windows with features and truth, drawn by other processes."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future

import numpy as np
from joblib.externals.loky import get_reusable_executor

from detectors.reader.examples import Examples
from detectors.reader.features import Features, make_features
from detectors.reader.prior import draw_examples

Batch = tuple[Features, Examples]  #: B windows: features with a leading axis, pairs in half precision; truth, no tracks


def draw_shard(
    number: int, *, seed: tuple[int, ...], batches: int, windows: int, without: tuple[str, ...], most_uavs: int
) -> list[Batch]:
    """Draw shard ``number`` of a seed: batches, each of one family of the prior, but those in ``without``."""
    rng = np.random.default_rng([*seed, number])
    return [_describe(draw_examples(rng, windows, without=without, most_uavs=most_uavs)) for _ in range(batches)]


def _describe(drawn: Examples) -> Batch:
    tracks = zip(drawn.position, drawn.velocity, drawn.seen, strict=True)
    pair, uav, context = map(np.stack, zip(*(make_features(*window) for window in tracks), strict=True))
    pair = np.clip(pair, -60.0, 60.0).astype(np.float16)
    none = {name: getattr(drawn, name)[:, :0] for name in ("position", "velocity", "seen")}
    return Features(pair, uav, context), drawn._replace(**none)


def draw_ahead(
    draw: Callable[[int], list[Batch]], numbers: range, workers: int, start: Callable[[], None]
) -> Iterator[list[Batch]]:
    """Yield shards in order while processes, begun by ``start``, draw the next, one each: so memory has a bound."""
    executor = get_reusable_executor(max_workers=max(1, min(workers, len(numbers))), timeout=None, initializer=start)
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
