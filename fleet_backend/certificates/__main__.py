"""``python -m fleet_backend.certificates``."""

import sys

from fleet_backend.certificates.cli import main

if __name__ == "__main__":
    sys.exit(main())
