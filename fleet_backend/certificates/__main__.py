"""``python -m fleet_backend.certificates``, and ``fleet-certificates`` itself."""

import sys
from functools import partial

from clutchdiag_io.starting import run_program

main = partial(run_program, "fleet_backend.certificates.cli")

if __name__ == "__main__":
    sys.exit(main())
