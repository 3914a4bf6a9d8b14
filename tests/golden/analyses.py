"""What the service made of a stored set of recordings: a change of the house changes none of it.

``python -m tests.golden.analyses`` prints what differs, ``--write`` takes today's analyses for right: for a change that
is meant to change them, with the figures before and after beside it.
"""

import argparse
import hashlib
import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import llvmlite.binding as llvm
import numpy as np
from scipy import linalg

FOLDER = Path(__file__).parent
RECORDINGS, ANALYSES = FOLDER / "recordings", FOLDER / "analyses"
ARITHMETIC = ANALYSES / "arithmetic.txt"
DATA = FOLDER.parent / "data"
OPTIONS = {
    "foreign": ["--dbc", str(DATA / "foreign.dbc"), "--profile", str(DATA / "foreign.toml")],
    "j1939": ["--profile", "j1939"],
}
NAMES = sorted(path.name.partition(".")[0] for path in RECORDINGS.glob("*.log.xz"))
CALIBRATED = "routine"
RELATIVE = 1e-9  # where the arithmetic is another machine's


def arithmetic() -> str:
    """Return a digest of what this machine and its libraries make of some sums: equal digests, equal last digits.

    The processor is part of it: kernels are compiled for it, and the order of their sums follows its registers.
    """
    grid = np.linspace(0.1, 3.0, 36).reshape(6, 6)
    matrix = np.exp(-np.abs(grid - grid.T)) + 6.0 * np.eye(6)
    parts = (linalg.cho_factor(matrix)[0], linalg.inv(matrix), matrix @ grid, np.tanh(grid), np.log(grid))
    sums = b"".join(np.ascontiguousarray(part).tobytes() for part in parts)
    return hashlib.sha256(sums + llvm.get_host_cpu_name().encode()).hexdigest()


def analysis(name: str) -> str:
    """Return what the service says today of a recording."""
    return _service("analyze", f"{name}.log.xz", *OPTIONS.get(name, []), "--json")


def calibration(folder: Path) -> tuple[str, str]:
    """Return what the service says today of a calibration, and the file that it writes."""
    path = folder / "found.toml"
    said = _service("calibrate", f"{CALIBRATED}.log.xz", "--vehicle", "golden", "--output", str(path), "--json")
    return said, path.read_text(encoding="utf-8")


def differences(before: str, now: str, *, is_exact: bool) -> Iterator[str]:
    """Yield how two texts of JSON lines differ; numbers may by a little unless all must be exact."""
    if before == now:
        return
    if is_exact:
        pairs = zip(before.splitlines(), now.splitlines(), strict=False)
        yield next((f"line {number}" for number, (one, other) in enumerate(pairs, 1) if one != other), "the end")
        return
    earlier, later = ([json.loads(line) for line in text.splitlines()] for text in (before, now))
    yield from _differing(earlier, later, "")


def _differing(before: object, now: object, place: str) -> Iterator[str]:
    if isinstance(before, dict) and isinstance(now, dict) and before.keys() == now.keys():
        for key in before:
            yield from _differing(before[key], now[key], f"{place}.{key}")
    elif isinstance(before, list) and isinstance(now, list) and len(before) == len(now):
        for number, (one, other) in enumerate(zip(before, now, strict=True)):
            yield from _differing(one, other, f"{place}[{number}]")
    elif isinstance(before, float) and isinstance(now, float):
        if abs(before - now) > RELATIVE * max(abs(before), abs(now), 1e-6):
            yield f"{place}: {before!r}, now {now!r}"
    elif before != now:
        yield f"{place}: {before!r}, now {now!r}"


def _service(*words: str) -> str:
    command = [sys.executable, "-m", "diag_service", *words]
    return subprocess.run(command, cwd=RECORDINGS, check=True, capture_output=True, text=True).stdout


def main() -> int:
    """Compare or write all analyses; return 1 if any differs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true")
    is_writing, count = parser.parse_args().write, 0
    for name in NAMES:
        path, now = ANALYSES / f"{name}.jsonl", analysis(name)
        found = [] if is_writing else list(differences(path.read_text(encoding="utf-8"), now, is_exact=False))
        is_equal = not is_writing and now == path.read_text(encoding="utf-8")
        if is_writing:
            path.write_text(now, encoding="utf-8")
        print(f"{name}: {len(now.splitlines())} lines, {'byte for byte' if is_equal else f'{len(found)} differ'}")
        print(*found[:5], sep="\n", end="\n" if found else "")
        count += len(found)
    if is_writing:
        with tempfile.TemporaryDirectory() as folder:
            said, file = calibration(Path(folder))
        (ANALYSES / "calibrate.jsonl").write_text(said, encoding="utf-8")
        (ANALYSES / "routine-calibration.toml").write_text(file, encoding="utf-8")
        ARITHMETIC.write_text(arithmetic() + "\n", encoding="utf-8")
    return 1 if count else 0


if __name__ == "__main__":
    sys.exit(main())
