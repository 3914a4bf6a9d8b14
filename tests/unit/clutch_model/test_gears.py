import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

from clutch_model.calibration import clutch_of_gear
from ecu_emulator.shift_control.tcu import clutch_of

ROOT = Path(__file__).parents[3]
WORDS = ("gear", "current", "target")


def halved(source: str) -> Iterator[int]:
    """Yield the lines on which a gear is taken modulo two."""
    for node in (one for one in ast.walk(ast.parse(source)) if isinstance(one, ast.BinOp)):
        is_halved = isinstance(node.op, ast.Mod) and ast.unparse(node.right) == "2"
        if is_halved and any(word in ast.unparse(node.left).lower() for word in WORDS):
            yield node.lineno


@pytest.mark.parametrize(("gear", "clutch"), [(1, 1), (2, 2), (3, 1), (4, 2), (5, 1), (6, 2), (7, 1), (8, 2), (0, 2)])
def test_clutch_1_carries_the_odd_gears(gear: int, clutch: int) -> None:
    assert clutch_of_gear(gear) == clutch
    assert clutch_of(gear) == clutch - 1  # the place in pairs, as the compiled control takes it


def test_nobody_else_decides_which_clutch_carries_a_gear() -> None:
    again = [
        f"{path.relative_to(ROOT)}:{line}"
        for package in ("ecu_emulator", "diag_service", "fleet_backend", "benchmarks", "demo")
        for path in sorted((ROOT / package).rglob("*.py"))
        for line in halved(path.read_text(encoding="utf-8"))
    ]
    assert again == []
