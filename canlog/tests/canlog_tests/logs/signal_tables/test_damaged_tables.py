"""Damaged tables end in values or in a clear error; ``python -m tests.tools.damaged_tables`` is the long form."""

import math
from pathlib import Path

import pytest

from tests.tools.damaged_tables import outcomes


@pytest.mark.parametrize("seed", [11, 12])
def test_damage_ends_in_values_or_in_a_clear_error(tmp_path: Path, seed: int) -> None:
    counts = outcomes(seed, tmp_path, math.inf, 150)
    assert {what for _, what in counts} == {"read", "refused"}
