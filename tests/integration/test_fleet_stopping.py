"""The backend is told to stop, at any moment and more than once: it ends with 0, without a word of its own trouble."""

import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from fleet_backend.database import open_database
from tests.plugins.broker import Mosquitto
from tests.support.patience import HANG_S

BEFORE, LOADED = "fleet_backend.choices", "fleet_backend.programs"  # modules; the first is loaded first
AGAIN_S = 1.0e-3


@pytest.mark.parametrize(
    ("word", "module", "pause_s"),
    [
        ("ingest", BEFORE, 0.0),
        ("serve", BEFORE, 0.1),
        ("watch", LOADED, 0.0),
        ("watch and serve", LOADED, 0.5),
        ("ingest", LOADED, 0.5),
        ("follow", LOADED, 0.0),
    ],
)
def test_signals_at_any_moment_end_the_backend_well(
    tmp_path: Path, broker: Mosquitto, sqlite_url: str, word: str, module: str, pause_s: float
) -> None:
    open_database(sqlite_url).dispose()
    options = {
        "ingest": ["--database", sqlite_url, "--broker", broker.url],
        "serve": ["--database", sqlite_url, "--listen", "127.0.0.1:0"],
        "watch": ["--database", sqlite_url],
        "watch and serve": ["--database", sqlite_url, "--listen", "127.0.0.1:0"],
        "follow": [broker.url],
    }
    said = tmp_path / "said.log"
    command = [sys.executable, "-X", "importtime", "-m", "fleet_backend", word.partition(" ")[0], *options[word]]
    with said.open("wb") as log, subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=log) as process:
        deadline_s = time.monotonic() + HANG_S
        while f"{module}\n" not in said.read_text(encoding="utf-8"):
            assert process.poll() is None
            assert time.monotonic() < deadline_s
            time.sleep(AGAIN_S)
        time.sleep(pause_s)
        while process.poll() is None:
            assert time.monotonic() < deadline_s
            process.send_signal(signal.SIGTERM)
            time.sleep(AGAIN_S)
    assert process.returncode == 0, said.read_text(encoding="utf-8")[-3000:]
    trouble = [line for line in said.read_text(encoding="utf-8").splitlines() if not line.startswith("import time:")]
    assert not [line for line in trouble if "Traceback" in line or "rror" in line], trouble
