"""What all tests share."""

import os

# Numba's cache of compiled loops is not safe for processes that compile different signatures of one function at the
# same time. Each process of pytest-xdist keeps a cache of its own, which must be said before Numba is imported.
if worker := os.environ.get("PYTEST_XDIST_WORKER"):
    os.environ.setdefault("NUMBA_CACHE_DIR", os.path.abspath(f".pytest_cache/numba-{worker}"))
    # As many processes as cores leave a core each: more threads than that make small tensor operations wait for each
    # other, a hundred times longer than they take. This, too, is read at the first import.
    os.environ.setdefault("OMP_NUM_THREADS", "1")

# A property doesn't depend on time, but Hypothesis's deadline (200 ms per example) and its check for slow generation
# do: on a busy machine the first `text()` of a process, which builds a table of Unicode, takes seconds and fails it.
from hypothesis import HealthCheck, settings

settings.register_profile("usnet", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("usnet")
