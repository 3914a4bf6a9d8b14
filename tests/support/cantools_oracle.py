"""What cantools decodes, signal by signal: the reference for the compiled tables."""

import math
from collections.abc import Sequence
from copy import copy

import numpy as np
import numpy.typing as npt
from cantools.database.can import Message
from cantools.database.can.signal import Signal
from cantools.database.errors import DecodeError, Error

FloatArray = npt.NDArray[np.float64]


def is_sound(message: Message) -> bool:
    """Return whether no signals of a message overlap: only then cantools decodes it as its layout says."""
    try:
        _holding(message, message.signals, strict=True)
    except Error:
        return False
    return True


def reference(message: Message, payloads: Sequence[bytes]) -> dict[str, FloatArray]:
    """Return all signals in all payloads, NaN where a signal is not in the frame.

    A payload whose multiplexers have values that the database does not list, cantools does not decode at all; and it
    misplaces signals that overlap. There each signal is decoded in a message that holds only it and its multiplexers.
    """
    values = {signal.name: np.full(len(payloads), math.nan) for signal in message.signals}
    sound = is_sound(message)
    alone = {signal.name: _alone(message, signal) for signal in message.signals}
    for row, payload in enumerate(payloads):
        whole = _decoded(message, payload) if sound else None
        for name, column in values.items():
            found = whole if whole is not None else _decoded(alone[name], payload)
            if found is not None and name in found:
                column[row] = found[name]
    return values


def _decoded(message: Message, payload: bytes) -> dict[str, float] | None:
    try:
        found = message.decode_simple(payload, decode_choices=False)
    except DecodeError:
        return None
    return {name: float(value) for name, value in found.items() if isinstance(value, int | float)}


def _alone(message: Message, signal: Signal) -> Message:
    """Return a message with one signal and the multiplexers above it."""
    by_name = {candidate.name: candidate for candidate in message.signals}
    chain = [copy(signal)]
    chain[0].is_multiplexer = False  # its own value is there whatever it selects
    while chain[-1].multiplexer_signal in by_name and len(chain) <= len(by_name):
        chain.append(by_name[chain[-1].multiplexer_signal or ""])
    return _holding(message, chain, strict=False)


def _holding(message: Message, signals: list[Signal], *, strict: bool) -> Message:
    """Return the message with these signals only."""
    return Message(
        message.frame_id,
        message.name,
        message.length,
        signals,
        strict=strict,
        is_extended_frame=message.is_extended_frame,
        is_fd=message.is_fd,
    )


def same_bits(actual: FloatArray, wanted: FloatArray) -> bool:
    """Return whether two columns are the same to the last bit, any NaN being as good as another."""
    is_nan = np.isnan(wanted)
    return bool(
        np.array_equal(np.isnan(actual), is_nan)
        and np.array_equal(actual[~is_nan].view(np.uint64), wanted[~is_nan].view(np.uint64))
    )
