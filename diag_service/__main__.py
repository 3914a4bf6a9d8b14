"""``python -m diag_service``, and ``diag-service`` itself."""

import sys
from functools import partial

from clutchdiag_io.program import run_program

main = partial(run_program, "diag_service.cli", ("run", "monitor"))

if __name__ == "__main__":
    sys.exit(main())
