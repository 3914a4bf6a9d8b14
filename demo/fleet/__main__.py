"""``python -m demo.fleet``: the fleet demonstration."""

import sys

from clutchdiag_io.start import run_program

if __name__ == "__main__":
    sys.exit(run_program("demo.fleet.command_line"))
