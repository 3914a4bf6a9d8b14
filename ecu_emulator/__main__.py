"""``python -m ecu_emulator``, and ``ecu-emulator`` itself."""

import sys
from functools import partial

from clutchdiag_io.program import run_program

main = partial(run_program, "ecu_emulator.cli")

if __name__ == "__main__":
    sys.exit(main())
