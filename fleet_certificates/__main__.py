"""``python -m fleet_certificates``."""

import sys

from fleet_certificates.cli import main

if __name__ == "__main__":
    sys.exit(main())
