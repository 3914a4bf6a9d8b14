"""Prints the thresholds of the verdict as docs/verdict.md has them: ``python -m tests.tools.threshold_table``.

With ``--write`` the document takes them.
"""

import argparse
import sys
from collections.abc import Sequence

from diag_service.diagnosis.condition.thresholds import THRESHOLDS, Cause, Ground, Silence, Situation, Threshold
from tests.support.documents import ROOT, page_text

PAGE = "docs/verdict.md"
BEGIN, END = "<!-- thresholds -->\n", "<!-- end of thresholds -->\n"


def table() -> str:
    """Return the table in Markdown: one row for what has the same threshold in the same situation."""
    shared: dict[tuple[Situation, Threshold], list[Ground]] = {}
    for (ground, situation), threshold in THRESHOLDS.items():
        shared.setdefault((situation, threshold), []).append(ground)
    rows = [
        (_named(grounds), situation.value, f"{threshold.value:g}", *threshold[1:])
        for (situation, threshold), grounds in shared.items()
    ]
    head = ("of", "situation", "value", "quantity", "why", "shown by")
    return "".join(f"| {' | '.join(row)} |\n" for row in (head, ["---"] * len(head), *rows))


def _named(grounds: Sequence[Ground]) -> str:
    if len(grounds) == len(Cause):
        return "every cause"
    words = [f"`{ground.name}`" if isinstance(ground, Silence) else str(ground) for ground in grounds]
    return ", ".join(words)


def with_table(text: str) -> str:
    """Return the document with today's table; raises ValueError if it has no place for one."""
    before, begin, rest = text.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not begin or not end:
        raise ValueError(f"{PAGE} has no place for the table")
    return f"{before}{BEGIN}\n{table()}\n{END}{after}"


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true", help=f"into {PAGE}")
    if parser.parse_args(arguments).write:
        (ROOT / PAGE).write_text(with_table(page_text(PAGE)), encoding="utf-8")
    else:
        sys.stdout.write(table())


if __name__ == "__main__":
    main()
