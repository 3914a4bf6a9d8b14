"""A controller killed at every step of keeping its trouble codes: none is lost, none invented, none comes back."""

import json
import subprocess
import sys
from pathlib import Path

from tests.support.patience import HANG_S
from tests.support.uds.killed_keeper import NEW, OLD

POSSIBLE: dict[str, list[list[int]]] = {
    "": [[OLD]],
    "s": [[OLD], [NEW, OLD]],  # the failure was on its way
    "sf": [[NEW, OLD], []],  # clearing was on its way
    "sfc": [[]],
}


def test_a_kill_at_any_step_loses_no_confirmed_code_and_invents_none(tmp_path: Path) -> None:
    told = subprocess.run(
        [sys.executable, "-m", "tests.support.uds.killed_keeper", str(tmp_path)],
        check=True, capture_output=True, text=True, timeout=HANG_S,
    )  # fmt: skip
    kills = [json.loads(line) for line in told.stdout.splitlines()]
    assert [kill for kill in kills if kill["confirmed"] not in POSSIBLE[kill["acknowledged"]]] == []
    assert len(kills) > 50
    found = {(kill["acknowledged"], len(kill["confirmed"])) for kill in kills}
    assert found >= {("", 1), ("s", 1), ("s", 2), ("sf", 2), ("sf", 0), ("sfc", 0)}  # both sides of every change
