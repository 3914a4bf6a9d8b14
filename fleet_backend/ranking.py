"""Which of two results for one shift is the newer: versions as texts that sort as people count."""

import re
from functools import lru_cache
from typing import Final

_NUMBER: Final = re.compile(r"[0-9]+")
_BETWEEN: Final = "\x1f"  # the unit separator, below every printable character


@lru_cache(maxsize=1024)
def version_rank(algorithm_version: str, calibration_version: str) -> str:
    """Return a text that is greater, byte by byte, for a newer algorithm or else a newer calibration.

    Numbers inside a version count as numbers, so ``-10`` is newer than ``-9``. The rank depends on the versions alone,
    not on when a result arrived, and different versions have different ranks.
    """
    return _BETWEEN.join(_sortable(version) for version in (algorithm_version, calibration_version))


def _sortable(version: str) -> str:
    """Return the version with the length of each number before it."""
    return _NUMBER.sub(lambda match: f"{len(match[0]):03}{match[0]}", version)
