"""The canonical signals of a profile found in a database: which messages carry them, and how each becomes SI."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from cantools.database.can import Database, Message
from cantools.database.can.signal import Signal as DatabaseSignal

from canlog.database.addressing import Address, message_address
from canlog.errors import DefinitionError
from diag_service.diagnosis.columns import Signal
from diag_service.errors import ConfigError
from diag_service.mapping.profile import Conversion, Profile, SignalSource, to_si
from diag_service.mapping.source_tables import SourceTable, compile_source, find_message, signal_name

NS_PER_MS: Final = 1_000_000


@dataclass(frozen=True, slots=True, kw_only=True)
class SignalColumn:
    """One canonical signal of a message."""

    signal: Signal
    table: SourceTable
    to_si: Conversion
    limits: tuple[float, float] | None  # ends of the scale in SI, None if the database does not say


@dataclass(frozen=True, slots=True, kw_only=True)
class MessageColumns:
    """A message and the canonical signals it carries."""

    message: Message
    address: Address
    period_ns: int
    columns: tuple[SignalColumn, ...]


def map_signals(database: Database, profile: Profile) -> tuple[MessageColumns, ...]:
    """Return the messages that carry the signals of a profile; a lenient profile may name more than there are.

    Raises ConfigError with everything that does not fit: messages or signals that the database lacks, units of another
    kind, signals that cannot be decoded, a message with several source addresses.
    """
    found, problems = fitting(database, profile)
    if problems and not profile.is_lenient:
        raise ConfigError(f"profile {profile.name} does not fit the database: {'; '.join(problems)}")
    return found


def fitting(database: Database, profile: Profile) -> tuple[tuple[MessageColumns, ...], tuple[str, ...]]:
    """Return what of a profile the database has, and what it lacks, in words."""
    problems: list[str] = []
    found: dict[str, list[SignalColumn]] = {}
    messages: dict[str, Message] = {}
    senders: dict[str, set[int]] = {}
    for signal, source in profile.sources.items():
        try:
            message = find_message(database.messages, source)
            column = _column(message, signal, source, is_j1939=profile.is_j1939)
        except (ConfigError, DefinitionError) as error:
            problems.append(f"{error} (for {signal.value})")
            continue
        messages[message.name] = message
        found.setdefault(message.name, []).append(column)
        if source.source_address is not None:
            senders.setdefault(message.name, set()).add(source.source_address)
    problems += [f"several source addresses for {name}" for name, named in senders.items() if len(named) > 1]
    mapped = tuple(
        MessageColumns(
            message=messages[name],
            address=message_address(
                messages[name],
                is_j1939=profile.is_j1939,
                sender=min(senders.get(name, ()), default=None),
                channel=profile.channel,
            ),
            period_ns=(messages[name].cycle_time or 0) * NS_PER_MS,
            columns=tuple(columns),
        )
        for name, columns in found.items()
    )
    return mapped, tuple(problems)


def _column(message: Message, signal: Signal, source: SignalSource, *, is_j1939: bool) -> SignalColumn:
    """Return one compiled signal."""
    found = message.get_signal_by_name(signal_name(message, source))
    convert = to_si(signal, source, found.unit)
    is_plain = source.check_range and source.less is None and source.times is None
    return SignalColumn(
        signal=signal,
        table=compile_source(message, source, is_j1939=is_j1939),
        to_si=convert,
        limits=_limits(found, convert) if is_plain else None,
    )


def _limits(signal: DatabaseSignal, convert: Conversion) -> tuple[float, float] | None:
    """Return the ends of a signal's scale in SI."""
    if signal.minimum is None or signal.maximum is None or not signal.minimum < signal.maximum:
        return None
    low, high = np.sort(convert(np.array([signal.minimum, signal.maximum], np.float64))).tolist()
    return low, high
