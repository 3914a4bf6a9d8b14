"""A worker with one thing more: a log whose name says so takes memory until its process is ended.

Usage: ``dask worker --preload tests.support.lakes.greedy ...``.
"""

import time
from pathlib import Path

import diag_service.lake.work
from canlog.logs import Looked, looked_at

GREEDY = "greedy"  # in the name of the log
_BLOCK_BYTES = 64 << 20
_MOST_BLOCKS = 40
_PAUSE_S = 0.05


def look(path: Path, columns: str = "") -> Looked:
    """Look at a log as ever, or take memory."""
    if GREEDY in path.name:
        held = list[bytearray]()
        for _ in range(_MOST_BLOCKS):
            held.append(bytearray(b"x") * _BLOCK_BYTES)
            time.sleep(_PAUSE_S)
        raise RuntimeError(f"nobody minded {len(held)} blocks")
    return looked_at(path, columns)


diag_service.lake.work.looked_at = look  # type: ignore[attr-defined]  # in every process of a worker
