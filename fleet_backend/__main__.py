"""``python -m fleet_backend``: the same as ``fleet-backend``."""

import sys

from fleet_backend.cli import main

sys.exit(main())
