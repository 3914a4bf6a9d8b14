"""Whether a DBC text that cantools takes may still be read wrongly; a quick look, before a thorough one."""

import re
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from cantools.database.can import Database

# Multiplexers that are none, multiplexed signals without one, and floats: what cantools takes as it comes.
_SUSPECT: Final = re.compile(r"\bSG_\s+\w+\s+m\w*\s*:|\bSG_MUL_VAL_\s+\d|\bSIG_VALTYPE_\s+\d")


def has_doubts(text: str, database: "Database") -> bool:
    """Return whether a thorough look is called for."""
    if _SUSPECT.search(text):
        return True
    return any(len({signal.name for signal in message.signals}) < len(message.signals) for message in database.messages)
