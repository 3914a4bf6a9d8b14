"""Numerical libraries in one thread."""

import subprocess
import sys

COUNTED = """
import diag_service.cli, fleet_backend.cli, sys
assert "numpy" not in sys.modules
"""


def test_the_programs_say_so_before_numpy_is_loaded() -> None:
    subprocess.run([sys.executable, "-c", COUNTED], check=True)
