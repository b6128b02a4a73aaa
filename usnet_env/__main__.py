"""``python -m usnet_env`` runs the command ``usnet``."""

import sys

from usnet_env.cli import main

if __name__ == "__main__":  # worker processes import the main module again
    sys.exit(main())
