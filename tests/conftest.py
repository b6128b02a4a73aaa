"""What all tests share."""

import os

# As many processes as cores leave a core each: more threads than that make small tensor operations wait for each other,
# a hundred times longer than they take. This must be said before the libraries are imported.
if "PYTEST_XDIST_WORKER" in os.environ:
    os.environ.setdefault("OMP_NUM_THREADS", "1")

# A property doesn't depend on time, but Hypothesis's deadline (200 ms per example) and its check for slow generation
# do: on a busy machine the first `text()` of a process, which builds a table of Unicode, takes seconds and fails it.
from hypothesis import HealthCheck, settings

settings.register_profile("usnet", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("usnet")
