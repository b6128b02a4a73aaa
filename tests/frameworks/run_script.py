"""Run a script of the examples, and keep what it trained: the tests look at both."""

from __future__ import annotations

import contextlib
import io
from types import ModuleType
from typing import Any

import pytest


def run_script(script: ModuleType, *words: str) -> tuple[Any, list[str]]:
    """Run the main function of a script with these words; return what its ``train`` returned, and the lines printed."""
    train, kept = script.train, []

    def keep(*arguments: Any, **options: Any) -> Any:
        kept.append(train(*arguments, **options))
        return kept[-1]

    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(io.StringIO()) as printed:
        patch.setattr(script, "train", keep)
        script.main(words)
    (trained,) = kept
    return trained, printed.getvalue().splitlines()
