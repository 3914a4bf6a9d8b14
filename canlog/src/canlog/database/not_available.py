"""Which raw values of a signal say that there is no measurement, by two conventions and nothing wider.

A value table names states, and most states with an alarming name are values like any other: "Fault" of a warning lamp
is what its sender wanted to say. So a text alone takes nothing away. Only the ends of a scale are looked at, where
senders put what they cannot measure, and the codes that SAE J1939-71 sets apart.
"""

import re
from typing import Final

from cantools.database.can import Message
from cantools.database.can.signal import Signal

from canlog.database.addressing import J1939, parameter_group

CodeRange = tuple[int, int]  # raw values, both ends included

MIN_TEXT_BITS: Final = 2  # a single bit has no value to spare
DISCRETE_BITS: Final = 4  # J1939-71: states of two to four bits end with "error" and "not available"
BYTE_BITS: Final = 8
FIRST_INDICATOR: Final = 0xFB  # J1939-71, highest byte: FB indicator, FC and FD reserved, FE error, FF not available
PROPRIETARY_GROUPS: Final = frozenset({0xEF00, 0x1EF00, *range(0xFF00, 0x10000), *range(0x1FF00, 0x20000)})

_WORD_BORDER: Final = re.compile(r"(?<=[a-z])(?=[A-Z])")
_NO_VALUE: Final = re.compile(
    r"(?<![a-z])(n\s*/?\s*a|sna|snv|not[ _-]?av\w*|unavail\w*|not[ _-]?valid|invalid\w*|undefined|error\w*|fault\w*"
    r"|(not[ _-]?)?init\w*|fehler\w*|ung(ue|ü)ltig\w*|nicht[ _-]?verf(ue|ü)gbar\w*)(?![a-z])",
    re.IGNORECASE,
)
_DENIAL: Final = re.compile(
    r"(?<![a-z])(no|non|not|kein\w*|nicht|ohne|without)[\s_-]*(err|fault|fehler|invalid|ung(ue|ü)ltig)", re.IGNORECASE
)


def says_no_value(text: str) -> bool:
    """Return whether a text of a value table says that its raw value is not a measurement."""
    words = _WORD_BORDER.sub(" ", text)
    return _NO_VALUE.search(words) is not None and _DENIAL.search(words) is None


def no_value_codes(message: Message, signal: Signal, *, is_j1939: bool = False) -> tuple[CodeRange, ...]:
    """Return the raw values of an integer signal that are no measurements, as ranges.

    They are the codes that SAE J1939-71 sets apart, in messages of J1939 that are not proprietary, and the highest raw
    value (of a signed signal the lowest, too) if its text says that there is no value, with those next to it of which
    the same is true.

    Parameters
    ----------
    message, signal : Message, Signal
        As cantools parsed them.
    is_j1939 : bool
        Take a message with a 29-bit identifier for one of J1939, whatever the database says.
    """
    if signal.conversion.is_float or signal.length < MIN_TEXT_BITS:
        return ()
    codes = _named_ends(signal)
    if message.is_extended_frame and (is_j1939 or message.protocol == J1939) and not signal.is_signed:
        codes += _j1939_codes(message, signal)
    return _merged(codes)


def _merged(codes: list[CodeRange]) -> tuple[CodeRange, ...]:
    """Return the same raw values as ranges that rise and do not touch."""
    merged: list[CodeRange] = []
    for first, last in sorted(codes):
        if merged and first <= merged[-1][1] + 1:
            merged[-1] = merged[-1][0], max(last, merged[-1][1])
        else:
            merged.append((first, last))
    return tuple(merged)


def _j1939_codes(message: Message, signal: Signal) -> list[CodeRange]:
    """Return the codes that SAE J1939-71 sets apart in a parameter of this width."""
    if parameter_group(message.frame_id) in PROPRIETARY_GROUPS:
        return []
    highest = 2**signal.length - 1
    if signal.length >= BYTE_BITS:
        return [(FIRST_INDICATOR << (signal.length - BYTE_BITS), highest)]
    return [(highest - 1 if signal.length <= DISCRETE_BITS else highest, highest)]


def _named_ends(signal: Signal) -> list[CodeRange]:
    """Return the unbroken runs from the ends of the scale inwards whose texts all say that there is no value."""
    named = {int(code) for code, text in (signal.choices or {}).items() if says_no_value(str(text))}
    half = 2 ** (signal.length - 1)
    lowest, highest = (-half, half - 1) if signal.is_signed else (0, 2 * half - 1)
    first, last = highest, lowest  # inwards of the two runs
    while first in named:
        first -= 1
    while signal.is_signed and last in named:
        last += 1
    return [(begin, end) for begin, end in ((first + 1, highest), (lowest, last - 1)) if begin <= end]
