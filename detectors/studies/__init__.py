"""One file for each table or figure of the paper, and the commands ``usnet reproduce`` and ``usnet train``."""
