"""``python -m diag_service``, and ``diag-service`` itself."""

import sys

from clutchdiag_io.start import run_program


def main() -> int:
    """Run the program and return its exit status."""
    return run_program("diag_service.cli", ("run", "monitor"))


if __name__ == "__main__":
    sys.exit(main())
