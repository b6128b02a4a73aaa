"""What the tests of the studies share."""

import pytest

from usnet_env.evaluation.suite import Suite


@pytest.fixture
def asked(monkeypatch):
    """The games that a study asks for: it is stopped before it plays them."""
    games = []

    def stop(suite, tasks, *arguments, **options):
        games.extend(game for task in tasks for game in task)
        raise KeyboardInterrupt

    monkeypatch.setattr(Suite, "run", stop)
    return games
