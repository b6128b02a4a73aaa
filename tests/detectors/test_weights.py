"""Files of weights."""

from __future__ import annotations

import numpy as np
import torch

from detectors.weights import read_arrays, write_weights


def test_arrays_are_read_as_they_were_written_in_any_order_of_memory(tmp_path):
    grid = np.arange(12, dtype=np.float32).reshape(3, 4)
    arrays = {"fortran": np.asfortranarray(grid), "part": grid[::2, ::3], "tensor": torch.from_numpy(grid).T}
    arrays |= {"number": np.float64(2.5)}
    read = read_arrays(write_weights(tmp_path / "some.safetensors", arrays, {}, {}))
    for name, array in arrays.items():
        np.testing.assert_array_equal(read[name], np.asarray(array), strict=True)
