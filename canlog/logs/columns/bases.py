"""In which base a table has its identifiers: told by all of them together, where nobody says."""

import re
from collections.abc import Iterable, Sequence
from typing import Final

from canlog.logs.columns.roles import DECIMAL, HEXADECIMAL

LARGEST_ID: Final = 0x1FFF_FFFF
LARGEST_STANDARD_ID: Final = 0x7FF
FEWEST_LONG_DIGITS: Final = 7  # identifiers of 29 bits have seven or eight digits: below is no priority
LEAST_LETTERED: Final = 0.1  # of hexadecimal identifiers; fewer are damage
BARE: Final = re.compile(r"[0-9A-Fa-f]{1,10}")  # without 0x, and h or x behind it
CABANA: Final = frozenset({"time", "addr", "bus", "data"})
PANDA: Final = frozenset({"bus", "messageid", "message"})


def base_of(values: Iterable[str], names: Sequence[str]) -> tuple[int, str]:
    """Return the base of identifiers under a header, and what tells it if that is to be said."""
    bare = sorted({value for value in values if BARE.fullmatch(value)})
    plain = [value for value in bare if value.isdigit()]
    lettered = len(bare) - len(plain)
    words = {name.casefold() for name in names}
    between = [one for one in plain if int(one, 16) > LARGEST_STANDARD_ID and len(one) < FEWEST_LONG_DIGITS]
    base, why = HEXADECIMAL, "nothing shows that they are decimal (--columns id=...:dec says so)"
    if not plain or lettered >= LEAST_LETTERED * len(bare):
        why = ""
    elif any(len(value) > 1 and value.startswith("0") for value in plain):
        why = "they have leading zeros"
    elif words == CABANA or words >= PANDA:
        base, why = DECIMAL, f"its header is {'Cabana' if words == CABANA else 'Panda'}'s"
    elif lettered:
        base, why = DECIMAL, f"{lettered} of {len(bare)} has letters"
    elif any(int(value, 16) > LARGEST_ID for value in plain):
        base, why = DECIMAL, "as hexadecimal they would be too large"
    elif between:
        base, why = DECIMAL, f"as hexadecimal {between[0]} is too large for 11 bits, and too short for 29"
    return base, why
