"""The names of the package: what completion lists is there, and the lazy names stay lazy."""

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
        (
            "from usnet_env.cli import main; main(['--help'])",
            "torch sklearn scipy.stats rich.table matplotlib rerun pandas usnet_env.evaluation",
        ),
        ("import usnet_env.plugins; sorted(usnet_env.plugins.DETECTORS)", "detectors"),
        ("import detectors.policy_detector", "torch tensordict torchrl stable_baselines3"),
    ],
)
def test_what_is_not_needed_is_imported_later(fresh_process, program, later):
    program = f"import sys; {program}; print({{*{later.split()}}} & {{*sys.modules}})"
    assert fresh_process.run(program).splitlines()[-1] == "set()"
