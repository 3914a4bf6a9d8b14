"""How two texts differ: JSON lines value by value, others word by word, numbers within what another machine rounds."""

import hashlib
import itertools
import json
import re
from collections.abc import Iterator

import llvmlite.binding as llvm
import numpy as np
from scipy import linalg

RELATIVE = 1e-7  # where the arithmetic is another machine's
_NUMBER = re.compile(r"(-?\d+(?:\.\d+)?)")


def arithmetic() -> str:
    """Return a digest of what this machine and its libraries make of some sums: equal digests, equal last digits.

    The processor is part of it: kernels are compiled for it, and the order of their sums follows its registers.
    """
    grid = np.linspace(0.1, 3.0, 36).reshape(6, 6)
    matrix = np.exp(-np.abs(grid - grid.T)) + 6.0 * np.eye(6)
    parts = (linalg.cho_factor(matrix)[0], linalg.inv(matrix), matrix @ grid, np.tanh(grid), np.log(grid))
    sums = b"".join(np.ascontiguousarray(part).tobytes() for part in parts)
    return hashlib.sha256(sums + llvm.get_host_cpu_name().encode()).hexdigest()


def differences(before: str, now: str, *, is_exact: bool) -> Iterator[str]:
    """Yield how two texts differ; numbers may by a little unless all must be exact."""
    if before == now:
        return
    if is_exact:
        pairs = zip(before.splitlines(), now.splitlines(), strict=False)
        yield next(
            (
                f"line {number}: {one!r}, now {other!r}"[:600]
                for number, (one, other) in enumerate(pairs, 1)
                if one != other
            ),
            "the end",
        )
    elif before.startswith("{"):
        earlier, later = ([json.loads(line) for line in text.splitlines()] for text in (before, now))
        yield from _differing(earlier, later, "")
    else:
        words = itertools.zip_longest(_NUMBER.split(before), _NUMBER.split(now), fillvalue="")
        yield from (f"{one!r}, now {other!r}" for one, other in words if not _is_rounded_alike(one, other))


def _is_rounded_alike(before: str, now: str) -> bool:
    if not (_NUMBER.fullmatch(before) and _NUMBER.fullmatch(now)):
        return before == now
    one, other, places = float(before), float(now), len(before.partition(".")[2])
    return abs(one - other) <= max(1.01 * 10.0**-places, RELATIVE * abs(one))


def _differing(before: object, now: object, place: str, scale: float = 0.0) -> Iterator[str]:
    if isinstance(before, dict) and isinstance(now, dict) and before.keys() == now.keys():
        for key in before:
            yield from _differing(before[key], now[key], f"{place}.{key}")
    elif isinstance(before, list) and isinstance(now, list) and len(before) == len(now):
        # Of a matrix what is next to nothing beside the rest is a difference of large numbers: all rounding.
        scale = max((abs(one) for one in before if isinstance(one, float)), default=0.0)
        for number, (one, other) in enumerate(zip(before, now, strict=True)):
            yield from _differing(one, other, f"{place}[{number}]", scale)
    elif isinstance(before, float) and isinstance(now, float):
        if abs(before - now) > RELATIVE * max(abs(before), abs(now), scale, 1e-6):
            yield f"{place}: {before!r}, now {now!r}"
    elif before != now:
        yield f"{place}: {before!r}, now {now!r}"
