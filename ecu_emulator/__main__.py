"""``python -m ecu_emulator``."""

import sys

from ecu_emulator.cli import main

sys.exit(main())
