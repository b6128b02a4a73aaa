"""The conformance checks for detectors, one pytest case for each check."""

from most_copied import MostCopied

from detectors.checks import parametrize_with_checks


@parametrize_with_checks([MostCopied(), MostCopied(votes=1)])
def test_conformance(detector, check):
    """Run one check."""
    check(detector)
