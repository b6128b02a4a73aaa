"""The memory limit of a child process; what else a child does is in test_failures.py."""

import pytest

from usnet_env.evaluation.child import limit_memory

pytest.importorskip("resource")


def test_memory_is_limited_in_the_block_and_a_hard_limit_stays():
    with pytest.raises(MemoryError, match="more than 100 MB, the memory limit"), limit_memory(100):
        bytearray(1_000_000_000)
    with limit_memory(100):
        bytearray(50_000_000)
    bytearray(200_000_000)


def test_a_hard_limit_that_is_there_already_is_respected(fresh_process):
    program = """
import resource
from usnet_env.evaluation.child import limit_memory
hard = 20_000_000_000
resource.setrlimit(resource.RLIMIT_DATA, (hard, hard))
with limit_memory(10_000_000):
    print(resource.getrlimit(resource.RLIMIT_DATA) == (hard, hard))
with limit_memory(100):
    print(resource.getrlimit(resource.RLIMIT_DATA)[0] < hard)
print(resource.getrlimit(resource.RLIMIT_DATA) == (hard, hard))
"""
    assert fresh_process.run(program).split() == ["True"] * 3
