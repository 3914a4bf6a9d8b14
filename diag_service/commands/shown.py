"""What a command has found: one JSON object for programs, or lines for people."""

import sys
from collections.abc import Iterable, Mapping

from rich.text import Text

from clutch_results.records import dump
from diag_service.console import PeopleConsole


def show(record: Mapping[str, object], lines: Iterable[str | Text], *, as_json: bool) -> None:
    if as_json:
        sys.stdout.write(dump(record) + "\n")
    else:
        PeopleConsole().print_all(lines)
