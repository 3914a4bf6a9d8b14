"""Prints the metrics of a vehicle and of the fleet as a page of the site: ``python -m tests.tools.metrics_page``."""

import ast
from collections.abc import Iterator, Sequence
from pathlib import Path

import fleet_backend
from diag_service.service.metrics import families
from tests.support.histories import history
from tests.unit.diag_service.service.test_metrics import FILL, snapshot


def page() -> str:
    """Return the page that lists what can be scraped."""
    parts = ("# Metrics", "## A vehicle's service", _table(_of_a_vehicle()), "## The backend", _table(_of_the_fleet()))
    return "\n\n".join(parts) + "\n"


def _table(rows: Iterator[Sequence[str]]) -> str:
    return "\n".join(f"| {' | '.join(row)} |" for row in (("metric", "meaning", "labels"), ("---",) * 3, *rows))


def _row(name: str, meaning: str, labels: Sequence[str], *, is_counter: bool) -> tuple[str, ...]:
    return f"`{name}{'_total' if is_counter else ''}`", meaning, ", ".join(f"`{label}`" for label in labels)


def _of_a_vehicle() -> Iterator[Sequence[str]]:
    for family in sorted(families(snapshot(*history(60), fluid=FILL)), key=lambda family: family.name):
        labels = vars(family)["_labelnames"]
        yield _row(family.name, family.documentation, labels, is_counter=family.type == "counter")


def _of_the_fleet() -> Iterator[Sequence[str]]:
    """Yield what the backend's calls of ``gauge`` and ``counter`` say: some are told only where there is a database."""
    texts = [path.read_text(encoding="utf-8") for path in Path(fleet_backend.__file__).parent.rglob("*.py")]
    calls = [node for text in texts for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Call)]
    rows = []
    for call in calls:
        kind = ast.unparse(call.func)
        if kind in {"gauge", "counter"}:
            name, meaning, *labels = [str(one.value) for one in call.args if isinstance(one, ast.Constant)]
            rows.append(_row(f"clutchdiag_{name}", meaning, labels, is_counter=kind == "counter"))
    yield from sorted(rows)


if __name__ == "__main__":
    print(page(), end="")
