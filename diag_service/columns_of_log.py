"""All signals of a log, decoded by a database, batch by batch: for people who look, not for the diagnosis."""

import logging
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from cantools.database.can import Message

from diag_service.decode import BoolArray, SignalTable, compile_signal, payload_words
from diag_service.errors import ConfigError
from diag_service.frames import FrameBatch
from diag_service.message_index import MessageIndex
from diag_service.records import FloatArray, Int64Array

_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class CompiledMessage:
    """A message and the tables of its signals; those that cannot be decoded are left out."""

    message: Message
    tables: tuple[tuple[str, SignalTable], ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class SignalValues:
    """One signal in the frames of one message."""

    name: str
    value: FloatArray  # (n,) in the unit of the database
    is_good: BoolArray | None  # (n,) not available, out of range or multiplexed out where false; None: all are good

    def masked(self) -> FloatArray:
        """Return the values with NaN where there is none, shape (n,)."""
        return self.value if self.is_good is None else np.where(self.is_good, self.value, np.nan)


@dataclass(frozen=True, slots=True, kw_only=True)
class MessageValues:
    """The frames of one message in a batch."""

    place: int  # of the message in the index
    rows: Int64Array  # (n,) of the batch
    signals: Sequence[SignalValues]


class LogDecoder:
    """Decodes every signal of every message that comes; a message is compiled when it first does."""

    def __init__(self, index: MessageIndex) -> None:
        self.index = index
        self._compiled: dict[int, CompiledMessage] = {}
        self.short_count = 0  # frames shorter than their message

    def feed(self, batch: FrameBatch) -> Iterator[MessageValues]:
        """Yield the messages of a batch with their values."""
        places = self.index.places(batch.can_id)
        for place in np.unique(places[places >= 0]).tolist():
            compiled = self.compiled(place)
            rows = np.flatnonzero(places == place)
            is_long = batch.length[rows] >= compiled.message.length
            self.short_count += int(np.count_nonzero(~is_long))
            rows = rows[is_long]
            if len(rows):
                yield MessageValues(place=place, rows=rows, signals=_values(compiled, batch, rows))

    def compiled(self, place: int) -> CompiledMessage:
        """Return the tables of a message."""
        if place not in self._compiled:
            self._compiled[place] = compile_message(self.index.messages[place])
        return self._compiled[place]


def compile_message(message: Message) -> CompiledMessage:
    """Return the tables of all signals of a message that can be decoded; the others are warned of."""
    tables: list[tuple[str, SignalTable]] = []
    for signal in message.signals:
        try:
            tables.append((signal.name, compile_signal(message, signal.name)))
        except ConfigError as exc:
            _LOG.warning("%s", exc)
    return CompiledMessage(message=message, tables=tuple(tables))


def _values(compiled: CompiledMessage, batch: FrameBatch, rows: Int64Array) -> list[SignalValues]:
    words = payload_words(batch.data[rows])
    found = ((name, table.decode(words)) for name, table in compiled.tables)
    return [SignalValues(name=name, value=decoded.value, is_good=decoded.is_good) for name, decoded in found]
