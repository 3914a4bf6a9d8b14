"""``fleet-certificates``, or ``python -m fleet_backend.certificates``."""

import sys

from program_io.starting import run_program


def main() -> int:
    """Run the program and return its exit status."""
    return run_program("fleet_backend.certificates.cli")


if __name__ == "__main__":
    sys.exit(main())
