"""What detectors share about series of observations."""
