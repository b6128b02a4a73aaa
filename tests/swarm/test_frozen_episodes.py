"""A model that flies differently needs a new version: its episodes are frozen."""

import json

import numpy as np
import pytest
from frozen_episodes import FILE, make_entries

ENTRIES = make_entries()


@pytest.mark.parametrize("name", ENTRIES)
def test_the_model_flies_as_its_version_did(name):
    """If it is meant to fly differently, increase its ``version`` and run frozen_episodes.py."""
    frozen = json.loads(FILE.read_text(encoding="utf-8"))[name]
    now = ENTRIES[name]()
    if isinstance(frozen[0], dict):
        for one, other in zip(now, frozen, strict=True):
            assert one == {key: pytest.approx(value) for key, value in other.items()}
    else:
        np.testing.assert_allclose(now, frozen, atol=0.02)
