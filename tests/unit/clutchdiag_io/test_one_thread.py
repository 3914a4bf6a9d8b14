"""Numerical libraries in one thread."""

import os
import subprocess
import sys

import pytest

from clutchdiag_io.program import reckon_in_one_thread

THREADS = "OPENBLAS_NUM_THREADS"
COUNTED = """
import diag_service.cli, fleet_backend.cli, sys
assert "numpy" not in sys.modules
"""


def test_what_the_environment_says_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(THREADS, "4")
    reckon_in_one_thread()
    assert os.environ[THREADS] == "4"
    monkeypatch.delenv(THREADS)
    reckon_in_one_thread()
    assert os.environ[THREADS] == "1"


def test_the_programs_say_so_before_numpy_is_loaded() -> None:
    subprocess.run([sys.executable, "-c", COUNTED], check=True)
