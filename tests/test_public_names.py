"""The names of the package: what completion lists is there, and the lazy names stay lazy."""

import pytest

import usnet_env


def test_dir_lists_every_public_name():
    assert set(usnet_env.__all__) <= set(dir(usnet_env))
    assert dir(usnet_env) == sorted(set(dir(usnet_env)))
    for name in dir(usnet_env):
        getattr(usnet_env, name)


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="module 'usnet_env' has no attribute 'evaluated'"):
        _ = usnet_env.evaluated


def test_dir_imports_nothing(fresh_process):
    code = "import sys, usnet_env; dir(usnet_env); print('usnet_env.evaluation' in sys.modules)"
    assert fresh_process.run(code).strip() == "False"
