"""``python -m demo``: the demonstration."""

import sys

from clutchdiag_io.start import run_program

if __name__ == "__main__":
    sys.exit(run_program("demo.command_line"))
