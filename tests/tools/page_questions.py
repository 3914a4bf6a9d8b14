"""Schemathesis against the interface of the fleet's page: questions by its own description, sound ones and others.

A fleet with something of everything is served on loopback, and somebody of a workshop asks, so that every operation is
open. What the description does not allow is a remark: a server error, an answer of another shape, a sound question that
is refused, a wrong one that is answered. Ends with status 1 if there is any. Schemathesis is no
requirement of the project:

    python -m venv schemathesis && schemathesis/bin/pip install schemathesis
    python -m tests.tools.page_questions --schemathesis schemathesis/bin/schemathesis --minutes 10
"""

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

from fleet_backend.database import open_database
from fleet_backend.migrate import migrate
from fleet_backend.page.site import OPENAPI_PATH
from tests.support.fleet_page import ACCESS, fill_database, headers_of, raise_alarms, served

S_PER_MIN = 60.0


def fleet(folder: Path) -> str:
    """Make a fleet with results, alarms, fluid and a quarantine, and return where it is."""
    database = f"sqlite:///{folder / 'fleet.sqlite'}"
    engine = open_database(database)
    migrate(engine)
    fill_database(engine)
    raise_alarms(engine)
    engine.dispose()
    return database


def asked(program: str, address: str, minutes: float, seed: int, folder: Path) -> int:
    """Ask for some minutes, and return the status with which it ends."""
    headers = [word for name, value in headers_of("bob").items() for word in ("--header", f"{name}: {value}")]
    command = [
        *(program, "run", f"{address}{OPENAPI_PATH}", *headers),
        *("--max-time", str(max(1, round(minutes * S_PER_MIN))), "--seed", str(seed)),
        *("--continue-on-failure", "--suppress-health-check", "all", "--workers", "1", "--no-color"),
    ]
    return subprocess.run(command, check=False, cwd=folder).returncode


def main() -> int:
    """Serve, ask, and return what Schemathesis returns."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--schemathesis", default="schemathesis", metavar="PROGRAM")
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    program = options.schemathesis
    with tempfile.TemporaryDirectory() as name, served(fleet(Path(name)), ACCESS) as address:
        if Path(program).exists():
            program = str(Path(program).absolute())
        return asked(program, address, options.minutes, options.seed, Path(name))


if __name__ == "__main__":
    sys.exit(main())
