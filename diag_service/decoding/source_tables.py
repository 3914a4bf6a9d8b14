"""Sources of a profile found in a database and compiled: one decodable column per canonical signal."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from cantools.database.can import Message

from diag_service.columns import FloatArray
from diag_service.decoding.decode import BoolArray, Decoded, PayloadWords, SignalTable, compile_signal
from diag_service.definitions.addressing import parameter_group
from diag_service.definitions.profile import SignalSource
from diag_service.errors import ConfigError


@dataclass(frozen=True, slots=True)
class SourceTable:
    """One source, compiled: the signal itself and those of the same message that correct it."""

    main: SignalTable
    less: SignalTable | None
    times: SignalTable | None
    valid: tuple[float, float] | None
    invalid: tuple[float, ...]

    def decode(self, words: PayloadWords) -> Decoded:
        """Return the source in every payload, in the unit of the database."""
        found = self.main.decode(words)
        if self.less is None and self.times is None and self.valid is None and not self.invalid:
            return found
        good = self._good(found)
        value = found.value
        if self.less is not None:
            value, good = _combined(self.less.decode(words), good, value, np.subtract)
        if self.times is not None:
            value, good = _combined(self.times.decode(words), good, value, np.multiply)
        present = np.ones(len(value), np.bool_) if found.is_good is None else found.is_good
        worse = int(np.count_nonzero(present & ~good))
        return Decoded(value, None if good.all() else good, found.invalid_count + worse)

    def _good(self, found: Decoded) -> BoolArray:
        """Return which values of the signal itself the profile calls measurements."""
        good = np.ones(len(found.value), np.bool_) if found.is_good is None else found.is_good.copy()
        if self.valid is not None:
            good &= (found.value >= self.valid[0]) & (found.value <= self.valid[1])
        if self.invalid:
            good &= ~np.isin(found.value, self.invalid)
        return good


def compile_source(message: Message, source: SignalSource) -> SourceTable:
    """Return the compiled source.

    Raises
    ------
    ConfigError
        If the message lacks one of the signals, or one cannot be decoded.
    """

    def compiled(name: str) -> SignalTable:
        if name not in {signal.name for signal in message.signals}:
            raise ConfigError(f"{message.name} has no signal {name}")
        return compile_signal(message, name, check_range=source.check_range)

    return SourceTable(
        main=compiled(signal_name(message, source)),
        less=None if source.less is None else compiled(source.less),
        times=None if source.times is None else compiled(source.times),
        valid=source.valid,
        invalid=source.invalid,
    )


def find_message(messages: Sequence[Message], source: SignalSource) -> Message:
    """Return the message of a source, by its name or by its J1939 parameter group.

    Raises
    ------
    ConfigError
        If the database has none.
    """
    for message in messages:
        if source.pgn is None:
            is_meant = message.name == source.message
        else:
            is_meant = message.is_extended_frame and parameter_group(message.frame_id) == source.pgn
        if is_meant:
            return message
    raise ConfigError(f"the database has no message {source.message or f'of PGN {source.pgn}'}")


def signal_name(message: Message, source: SignalSource) -> str:
    """Return the name of the signal of a source, by that name or by its J1939 parameter number.

    Raises
    ------
    ConfigError
        If the message has none.
    """
    for signal in message.signals:
        if signal.name == source.signal if source.spn is None else signal.spn == source.spn:
            return signal.name
    raise ConfigError(f"{message.name} has no signal {source.signal or f'with SPN {source.spn}'}")


def _combined(other: Decoded, good: BoolArray, value: FloatArray, operation: np.ufunc) -> tuple[FloatArray, BoolArray]:
    """Return a value combined with another signal of the same frames, and where both are measurements."""
    combined: FloatArray = operation(value, other.value)
    return combined, good if other.is_good is None else good & other.is_good
