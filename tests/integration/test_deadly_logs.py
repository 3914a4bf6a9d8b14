"""A log that ends its process is told, and the others of its folder are done."""

import json
import subprocess
import sys
from pathlib import Path

from tests.plugins.drives import SHIFT_COUNT
from tests.support.folders import fill_folder
from tests.support.patience import HANG_S
from tests.support.service import environment


def test_a_log_that_ends_its_process_is_told_and_the_others_are_done(drive_log: Path, tmp_path: Path) -> None:
    paths = fill_folder(tmp_path / "logs", drive_log, 2)
    paths[0].rename(paths[0].with_name("deadly.log"))
    output = tmp_path / "out.jsonl"
    words = ["analyze", str(tmp_path / "logs"), "-o", str(output), "--jobs", "2"]
    command = [sys.executable, "-m", "tests.support.lakes.deadly", *words]
    ended = subprocess.run(command, capture_output=True, text=True, env=environment(), timeout=HANG_S, check=False)
    assert ended.returncode == 0, ended.stderr
    assert "its process died, also with nothing beside it" in ended.stdout
    records = [json.loads(line) for line in output.read_text(encoding="utf-8").splitlines()]
    drives = {Path(one["paths"][0]).name: one["error"] for one in records if "error" in one}
    assert [name for name, error in drives.items() if error] == ["deadly.log"]
    assert len(records) - len(drives) == SHIFT_COUNT
