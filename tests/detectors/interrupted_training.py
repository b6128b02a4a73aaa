"""What the tests of trainings share: an end in the middle, and what must be the same after it."""

import csv
from contextlib import contextmanager

import numpy as np
import torch


class Interrupted(Exception):
    """Stands for whatever ends a training early."""


def stop_at(limit):
    """A progress callback that ends the training when ``limit`` is reached."""

    def progress(done, total):
        if done >= limit:
            raise Interrupted

    return progress


@contextmanager
def unchanged_generators():
    """The global generators are the same afterwards."""

    def states():
        return torch.random.get_rng_state().tolist(), np.random.get_state()[1].tobytes()  # noqa: NPY002

    before = states()
    yield
    assert states() == before


def same_files(one, two):
    contents = [{path.name: path.read_bytes() for path in folder.iterdir()} for folder in (one, two)]
    assert contents[0] == contents[1]


def read_losses(folder):
    with (folder / "losses.csv").open(newline="") as file:
        return list(csv.DictReader(file))
