"""Names of messages as names of files: ones that every system takes, and of which no two are alike on any."""

import unicodedata
from collections.abc import Iterable
from typing import Final

LONGEST_BYTES: Final = 160  # of a name without number and suffix; systems take 255
_KEPT: Final = frozenset("-_+@=.")
_DEVICES: Final = frozenset(
    {"con", "prn", "aux", "nul", *(f"{port}{number}" for port in ("com", "lpt") for number in range(10))}
)  # of Windows, whatever the suffix
_NAMELESS: Final = "_"


def file_names(names: Iterable[str]) -> tuple[str, ...]:
    """Return a name of a file, without a suffix, for each name.

    Letters and digits of any script stay, what a system or a shell might take for something else becomes ``_``. Names
    that differ in nothing but case, or become alike, get a number.
    """
    found: list[str] = []
    taken: set[str] = set()
    for name in names:
        safe = own = _safe(name)
        number = 1
        while safe.casefold() in taken:
            number += 1
            safe = f"{own}-{number}"
        taken.add(safe.casefold())
        found.append(safe)
    return tuple(found)


def _safe(name: str) -> str:
    composed = unicodedata.normalize("NFC", name)
    kept = "".join(one if one.isalnum() or one in _KEPT else _NAMELESS for one in composed)
    kept = kept.encode(errors="replace")[:LONGEST_BYTES].decode(errors="ignore").strip(".") or _NAMELESS
    return f"{_NAMELESS}{kept}" if kept.split(".")[0].casefold() in _DEVICES else kept
