"""``ecu-emulator``, or ``python -m ecu_emulator``."""

import sys

from program_io.starting import run_program


def main() -> int:
    """Run the program and return its exit status."""
    return run_program("ecu_emulator.cli")


if __name__ == "__main__":
    sys.exit(main())
