"""``python -m diag_service``: the same as ``diag-service``."""

import sys

from diag_service.cli import main

sys.exit(main())
