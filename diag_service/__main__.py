"""``diag-service``, or ``python -m diag_service``."""

import sys

from program_io.starting import run_program


def main() -> int:
    """Run the program and return its exit status."""
    return run_program("diag_service.cli")


if __name__ == "__main__":
    sys.exit(main())
