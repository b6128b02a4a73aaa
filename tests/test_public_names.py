"""The names of the package: what completion lists is there, and the lazy names stay lazy."""

import subprocess
import sys

import pytest

import usnet_env


def test_every_public_name_is_there():
    assert dir(usnet_env) == sorted(usnet_env.__all__)
    for name in dir(usnet_env):
        getattr(usnet_env, name)
    with pytest.raises(AttributeError, match="module 'usnet_env' has no attribute 'evaluated'"):
        _ = usnet_env.evaluated


@pytest.mark.parametrize(
    ("program", "later"),
    [
        ("import usnet_env; dir(usnet_env)", "usnet_env.evaluation numba pandas"),
        ("from usnet_env.cli import main; assert main(['detect', 'no file']) == 2", "numba scipy detectors"),
    ],
)
def test_what_is_not_needed_is_imported_later(program, later):
    program = f"import sys; {program}; print({{*{later.split()}}} & {{*sys.modules}})"
    printed = subprocess.check_output([sys.executable, "-c", program], timeout=600, text=True)
    assert printed == "set()\n"
