"""What cantools decodes, signal by signal: the reference for the compiled tables."""

import math
from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from cantools.database.can import Message
from cantools.database.can.signal import Signal
from cantools.database.errors import DecodeError, Error
from cantools.database.namedsignalvalue import NamedSignalValue

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]
NumberAndText = tuple[float | None, str | None]
Named = dict[str, NumberAndText]


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


@dataclass(frozen=True, slots=True)
class Readings:
    """One signal in some payloads, as cantools reads it."""

    number: FloatArray  # (n,)
    is_there: BoolArray  # (n,) whether it is in the payload
    text: list[str | None]  # (n,) the name of its value, None where it has none


def readings(message: Message, signals: Mapping[str, Signal], payloads: Sequence[bytes]) -> dict[str, Readings]:
    """Return signals in payloads of any length, each number and its text; as ``reference`` where cantools gives up."""
    is_plain = is_sound(message) and all(name == signal.name for name, signal in signals.items())
    alone = {name: _alone(message, signal) for name, signal in signals.items()}
    found: dict[str, list[NumberAndText]] = {name: [] for name in signals}
    for payload in payloads:
        whole = _both(message, payload) if is_plain else None
        for name, signal in signals.items():
            values = whole if whole is not None else _both(alone[name], payload) or {}
            number, text = values.get(signal.name, (None, None))
            found[name].append((number, text if _is_whole(signal, number) else None))
    return {
        name: Readings(
            np.array([math.nan if number is None else number for number, _ in pairs], np.float64),
            np.array([number is not None for number, _ in pairs], np.bool_),
            [text for _, text in pairs],
        )
        for name, pairs in found.items()
    }


def _both(message: Message, payload: bytes) -> Named | None:
    """Return number and text of the signals of one payload; None if cantools cannot tell."""
    try:
        numbers = message.decode_simple(payload, decode_choices=False, allow_truncated=True)
        texts = message.decode_simple(payload, decode_choices=True, allow_truncated=True)
    except DecodeError:
        return None
    except (ValueError, OverflowError):  # it looks up a text for a float that is no number
        if len(message.signals) > 1:
            return None
        texts = numbers
    return {
        name: (float(value), str(text) if isinstance(text := texts[name], NamedSignalValue) else None)
        for name, value in numbers.items()
        if isinstance(value, int | float)
    }


def _is_whole(signal: Signal, number: float | None) -> bool:
    """Return whether a value can have a text: cantools gives a float the text of its whole part, we do not."""
    if not signal.conversion.is_float or number is None:
        return True
    return float((number - signal.offset) / signal.scale).is_integer()
