"""Benchmarks that put a double in place of a part of the service still fit it; here each is as short as it can be."""

import subprocess
import sys

import pytest

from tests.support.patience import HANG_S


@pytest.mark.parametrize(
    ("study", "words", "told"),
    [("service_memory", ("--hours", "0.01"), "h of bus time through the live service")],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_a_benchmark_still_fits_the_service(study: str, words: tuple[str, ...], told: str) -> None:
    command = [sys.executable, "-m", f"studies.{study}", *words]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=HANG_S)
    assert done.returncode == 0, done.stderr
    assert told in done.stdout
