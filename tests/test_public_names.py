"""The names of the package: what completion lists is there, and the lazy names stay lazy."""

import subprocess
import sys

import pytest

import usnet_env


def test_every_public_name_is_there():
    for name in usnet_env.__all__:
        getattr(usnet_env, name)
    with pytest.raises(AttributeError, match="module 'usnet_env' has no attribute 'evaluated'"):
        _ = usnet_env.evaluated


def test_an_environment_needs_no_evaluation():
    program = "import sys, usnet_env; dir(usnet_env); sys.exit('usnet_env.evaluation' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", program], timeout=600).returncode == 0
