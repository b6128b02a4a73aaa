"""Predictions from a UAV's own past, against one regression per UAV."""

import numpy as np
import pytest

from detectors.neural_granger.training import predict_from_own_past
from detectors.series.designs import stack_past


@pytest.mark.parametrize(("rows", "gap"), [(40, 4), (30, 1), (3, 1)])
def test_predictions_are_cross_fitted(rows, gap):
    steps = rows + 2
    rng = np.random.default_rng(5)
    velocity, seen = rng.standard_normal((steps, 6, 3)), rng.random((steps, 6)) >= 0.15
    past = stack_past(velocity, 2).reshape(6, rows, 6)
    target, weight = velocity[2:].swapaxes(0, 1), seen[2:].T.astype(float)
    found = predict_from_own_past(past, target, weight, 0.3, gap)
    for i in range(6):
        for row in range(rows):
            fold = [r for r in range(rows) if r * 8 // rows == row * 8 // rows]
            kept = [r for r in range(rows) if (r < fold[0] - gap or r > fold[-1] + gap) and weight[i, r]]
            gram, moment = 0.3 * np.eye(6), np.zeros((6, 3))
            for r in kept:
                gram += np.outer(past[i, r], past[i, r])
                moment += np.outer(past[i, r], target[i, r])
            np.testing.assert_allclose(found[i, row], past[i, row] @ np.linalg.solve(gram, moment), atol=1e-9)
