"""``python -m fleet_backend``, and ``fleet-backend`` itself."""

import sys

from clutchdiag_io.start import run_program


def main() -> int:
    """Run the program and return its exit status."""
    return run_program("fleet_backend.cli", ("ingest", "serve", "watch", "follow"))


if __name__ == "__main__":
    sys.exit(main())
