"""Writes the metrics of a vehicle's service into docs/monitoring.md: ``python -m tests.tools.metrics_page``."""

import re
from pathlib import Path
from typing import Final

from diag_service.service.metrics import families
from tests.support.histories import history
from tests.unit.diag_service.service.test_metrics import FILL, snapshot

DOCUMENT: Final = Path(__file__).parents[2] / "docs/monitoring.md"
_MARK: Final = re.compile(r"(<!-- metrics -->\n).*?(<!-- end -->)", re.DOTALL)


def written(text: str) -> str:
    """Return the page with the table as it should be."""
    rows = [
        (
            f"`{family.name}{'_total' if family.type == 'counter' else ''}`",
            family.documentation,
            ", ".join(f"`{label}`" for label in vars(family)["_labelnames"]),
        )
        for family in sorted(families(snapshot(*history(60), fluid=FILL)), key=lambda family: family.name)
    ]
    lines = [("metric", "meaning", "labels"), ("---",) * 3, *rows]
    table = "".join(f"| {' | '.join(line)} |\n" for line in lines)
    return _MARK.sub(lambda found: f"{found[1]}{table}{found[2]}", text)


if __name__ == "__main__":
    DOCUMENT.write_text(written(DOCUMENT.read_text(encoding="utf-8")), encoding="utf-8")
