"""What the tester makes of wrong answers, service by service: ``python -m tests.tools.uds_wrong_answers``."""

import sys
import tempfile
from pathlib import Path

from tests.support.uds.wrong_answers import table


def main() -> int:
    """Print the table and return 1 if a statement is not true."""
    untrue = count = 0
    with tempfile.TemporaryDirectory() as folder:
        for told in table(Path(folder)):
            count += 1
            untrue += not told.is_true
            verdict = "true" if told.is_true else "NOT TRUE"
            sys.stdout.write(f"{told.name:20} {told.way:24} {verdict:9} status {told.status}: {told.words}\n")
    sys.stdout.write(f"{count} answers, {untrue} statements that are not true\n")
    return 1 if untrue else 0


if __name__ == "__main__":
    sys.exit(main())
