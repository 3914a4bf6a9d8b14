"""``python -m ecu_emulator``, and ``ecu-emulator`` itself."""

import sys

from clutchdiag_io.start import run_program


def main() -> int:
    """Run the program and return its exit status."""
    return run_program("ecu_emulator.cli")


if __name__ == "__main__":
    sys.exit(main())
