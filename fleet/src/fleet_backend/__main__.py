"""``python -m fleet_backend``, and ``fleet-backend`` itself."""

import sys
from functools import partial

from clutchdiag_io.program import run_program

main = partial(run_program, "fleet_backend.cli", ("ingest", "serve", "watch", "follow"))

if __name__ == "__main__":
    sys.exit(main())
