"""The checks that every detector has to pass, one pytest case each."""

from most_copied import MostCopied

from detectors.checks import parametrize_with_checks


@parametrize_with_checks([MostCopied(), MostCopied(clusters=1)])
def test_the_contract(detector, check):
    """One check."""
    check(detector)
