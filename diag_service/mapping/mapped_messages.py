"""Canonical signals of a profile, found in a database: which messages carry them, each in SI, and what they allow."""

from collections.abc import Iterator, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass
from typing import Final

import numpy as np
from cantools.database.can import Database, Message
from cantools.database.can.signal import Signal as DatabaseSignal

from canlog.database.addressing import MessageAddress, message_address, parameter_group
from canlog.database.not_available import no_value_codes
from canlog.decode.signals import Decoded, InvalidCounts, PayloadWords, SignalTable, compile_signal
from canlog.errors import DefinitionError
from clutch_model.calibration import TorqueSource
from clutch_results.records import Tier
from diag_service.diagnosis.columns import BALANCE_SIGNALS, LOCKUP_SIGNALS, SLIP_SIGNALS, SUMMED_SIGNALS, Signal
from diag_service.errors import ConfigError
from diag_service.mapping.profile import AskedSource, BusSource, Profile, SignalSource, to_si
from diag_service.mapping.signal_words import listed
from diag_service.mapping.units import Conversion

NS_PER_MS: Final = 1_000_000


@dataclass(frozen=True, slots=True)
class SourceTable:
    """One source, compiled: the signal itself and those of the same message that correct it."""

    main: SignalTable
    less: SignalTable | None
    times: SignalTable | None
    valid: tuple[float, float] | None
    invalid: tuple[float, ...]
    values: tuple[float, ...]

    @property
    def is_corrected(self) -> bool:
        """Whether what the signal says is more than its number."""
        return (self.less, self.times, self.valid, self.invalid, self.values) != (None, None, None, (), ())

    def decode(self, words: PayloadWords) -> Decoded:
        """Return the source in every payload, in the unit of the database."""
        decoded = self.main.decode(words)
        if not self.is_corrected:
            return decoded
        good = np.ones(len(decoded.value), np.bool_) if decoded.is_good is None else decoded.is_good
        lowest, highest = self.valid or (-np.inf, np.inf)
        is_valid, is_code = (decoded.value >= lowest) & (decoded.value <= highest), np.isin(decoded.value, self.invalid)
        if self.values:
            is_valid &= np.isin(decoded.value, np.arange(len(self.values)))
        invalid = decoded.invalid.plus(
            InvalidCounts(
                not_available=int(np.count_nonzero(good & is_code)),
                out_of_range=int(np.count_nonzero(good & ~is_code & ~is_valid)),
            )
        )
        good = good & is_valid & ~is_code
        valid_count, value = int(np.count_nonzero(good)), decoded.value
        if self.values:
            value = np.array(self.values, np.float64)[np.where(good, value, 0.0).astype(np.int64)]
        for table, operation in ((self.less, np.subtract), (self.times, np.multiply)):
            if table is not None:
                other = table.decode(words)
                value = operation(value, other.value)
                good = good if other.is_good is None else good & other.is_good
        invalid = invalid.plus(InvalidCounts(incomplete=valid_count - int(np.count_nonzero(good))))
        return Decoded(value, None if good.all() else good, invalid, decoded.is_present)


@dataclass(frozen=True, slots=True, kw_only=True)
class MappedSignal:
    """One canonical signal of a message."""

    signal: Signal
    table: SourceTable
    to_si: Conversion
    is_optional: bool
    limits: tuple[float, float] | None  # ends of the scale in SI, None if the database does not say
    is_asked: bool = False  # a controller tells it whoever asks


@dataclass(frozen=True, slots=True, kw_only=True)
class MessageColumns:
    """A message and the canonical signals it carries."""

    message: Message
    address: MessageAddress
    period_ns: int
    columns: tuple[MappedSignal, ...]


def map_signals(database: Database, profile: Profile) -> tuple[MessageColumns, ...]:
    """Return the messages that carry the signals of a profile; a lenient profile may name more than there are.

    Raises ConfigError with everything that does not fit: messages or signals that the database lacks, units of another
    kind, signals that cannot be decoded, a message with several source addresses.
    """
    mapped, problems = fitting(database, profile)
    if problems and not profile.is_lenient:
        raise ConfigError(f"profile {profile.name} does not fit the database: {'; '.join(problems)}")
    return mapped


def fitting(database: Database, profile: Profile) -> tuple[tuple[MessageColumns, ...], tuple[str, ...]]:
    """Return what of a profile the database has, and what it lacks, in words."""
    problems: list[str] = []
    columns_of: dict[str, list[MappedSignal]] = {}
    messages: dict[str, Message] = {}
    senders: dict[str, set[int]] = {}
    for signal, source in profile.sources.items():
        try:
            message = find_message(database.messages, source)
            column = _column(message, signal, source, is_j1939=profile.is_j1939 and not isinstance(source, AskedSource))
        except (ConfigError, DefinitionError) as error:
            if source.optional:
                continue
            problems.append(f"{error} (for {signal.value})")
            continue
        messages[message.name] = message
        columns_of.setdefault(message.name, []).append(column)
        if isinstance(source, BusSource) and source.source_address is not None:
            senders.setdefault(message.name, set()).add(source.source_address)
    problems += [f"several source addresses for {name}" for name, named in senders.items() if len(named) > 1]
    mapped = tuple(
        MessageColumns(
            message=messages[name],
            address=message_address(
                messages[name],
                is_j1939=profile.is_j1939 and not columns[0].is_asked,
                sender=min(senders.get(name, ()), default=None),
                channel=profile.channel,
                others=database.messages,
            ),
            period_ns=(messages[name].cycle_time or 0) * NS_PER_MS,
            columns=tuple(columns),
        )
        for name, columns in columns_of.items()
    )
    return mapped, tuple(problems)


def _column(message: Message, signal: Signal, source: SignalSource, *, is_j1939: bool) -> MappedSignal:
    database_signal = message.get_signal_by_name(signal_name(message, source))
    convert = to_si(signal, source, database_signal.unit)
    is_whole = not source.values and not (isinstance(source, BusSource) and (source.less or source.times))
    return MappedSignal(
        signal=signal,
        table=compile_source(message, source, is_j1939=is_j1939),
        to_si=convert,
        is_optional=source.optional,
        limits=_limits(database_signal, convert) if source.check_range and is_whole else None,
        is_asked=isinstance(source, AskedSource),
    )


def _limits(signal: DatabaseSignal, convert: Conversion) -> tuple[float, float] | None:
    """Return the ends of a signal's scale in SI."""
    if signal.minimum is None or signal.maximum is None or not signal.minimum < signal.maximum:
        return None
    low, high = np.sort(convert(np.array([signal.minimum, signal.maximum], np.float64))).tolist()
    return low, high


def compile_source(message: Message, source: SignalSource, *, is_j1939: bool = False) -> SourceTable:
    """Return a source, compiled; raises ConfigError if the message lacks one of its signals, or one cannot be decoded.

    ``is_j1939`` takes a message with a 29-bit identifier for one of J1939, whatever the database says.
    """

    def compiled(name: str) -> SignalTable:
        signal = next((signal for signal in message.signals if signal.name == name), None)
        if signal is None:
            raise ConfigError(f"{message.name} has no signal {name}")
        codes = no_value_codes(message, signal, is_j1939=is_j1939) if source.check_codes else ()
        return compile_signal(message, signal, check_range=source.check_range, codes=codes)

    less, times = (source.less, source.times) if isinstance(source, BusSource) else (None, None)
    return SourceTable(
        main=compiled(signal_name(message, source)),
        less=None if less is None else compiled(less),
        times=None if times is None else compiled(times),
        valid=source.valid,
        invalid=source.invalid,
        values=source.values,
    )


def find_message(messages: Sequence[Message], source: SignalSource) -> Message:
    """Return the message of a source, by its name or by its J1939 parameter group.

    Raises ConfigError if the database has none.
    """
    pgn = source.pgn if isinstance(source, BusSource) else None
    for message in messages:
        is_of_group = message.is_extended_frame and parameter_group(message.frame_id) == pgn
        if is_of_group or message.name == source.message_name:
            return message
    raise ConfigError(f"the database has no message {source.message_name or f'of PGN {pgn}'}")


def signal_name(message: Message, source: SignalSource) -> str:
    """Return the name of the signal of a source, by that name or by its J1939 parameter number.

    Raises ConfigError if the message has none.
    """
    spn = source.spn if isinstance(source, BusSource) else None
    for signal in message.signals:
        if signal.name == source.signal_name if spn is None else signal.spn == spn:
            return signal.name
    raise ConfigError(f"{message.name} has no signal {source.signal_name or f'with SPN {spn}'}")


Alternative = frozenset[Signal]
Requirement = tuple[Alternative, ...]  # one of these sets

GEAR_PAIR: Final = frozenset({Signal.CURRENT_GEAR, Signal.TARGET_GEAR})
INPUT_PAIR: Final = frozenset({Signal.INPUT1_SPEED, Signal.INPUT2_SPEED})
INPUT: Final = frozenset({Signal.INPUT_SPEED})
TORQUE_COMMANDS: Final = frozenset({Signal.CLUTCH1_TORQUE_COMMAND, Signal.CLUTCH2_TORQUE_COMMAND})

PRESSURES: Final = frozenset({Signal.CLUTCH1_PRESSURE, Signal.CLUTCH2_PRESSURE})

MANDATORY: Final = frozenset({*BALANCE_SIGNALS, Signal.CURRENT_GEAR, Signal.TARGET_GEAR, Signal.SUMP_TEMPERATURE})
"""Without these there is no friction of dual clutches to estimate."""

FRICTION_SIGNALS: Final = MANDATORY | LOCKUP_SIGNALS

_TORQUE: Final[Requirement] = (frozenset({Signal.ENGINE_TORQUE}),)
_SPEED: Final[Requirement] = (frozenset({Signal.ENGINE_SPEED}),)
_GEARS: Final[Requirement] = (
    GEAR_PAIR,
    frozenset({Signal.TARGET_GEAR, Signal.ENGINE_SPEED, *INPUT}),
    frozenset({Signal.TARGET_GEAR, Signal.ENGINE_SPEED, *INPUT_PAIR}),
)
_REQUIREMENTS: Final[dict[Tier, tuple[Requirement, ...]]] = {
    Tier.FRICTION: (_GEARS, *((frozenset({signal}),) for signal in Signal if signal in MANDATORY - GEAR_PAIR)),
    Tier.TORQUE: (_SPEED, _GEARS, _TORQUE, (TORQUE_COMMANDS, frozenset({Signal.CLUTCH_TORQUE})), (INPUT_PAIR, INPUT)),
    Tier.KINEMATIC: (_SPEED, (*_GEARS, frozenset({Signal.CURRENT_GEAR}))),
}

_SLIP: Final[Requirement] = (frozenset({Signal.LOCKUP_SLIP}), frozenset({Signal.ENGINE_SPEED, Signal.TURBINE_SPEED}))
_LOCKUP_REQUIREMENTS: Final[dict[Tier, tuple[Requirement, ...]]] = {
    Tier.FRICTION: (
        (frozenset({Signal.ENGINE_SPEED}), SUMMED_SIGNALS),
        *((frozenset({signal}),) for signal in Signal if signal in LOCKUP_SIGNALS - {Signal.ENGINE_SPEED}),
    ),
    Tier.TORQUE: (_SLIP, _TORQUE, (frozenset({Signal.LOCKUP_PRESSURE_COMMAND}), frozenset({Signal.LOCKUP_PRESSURE}))),
    Tier.KINEMATIC: (_SLIP,),
}

PURPOSE: Final[dict[Tier, str]] = {
    Tier.FRICTION: "friction",
    Tier.TORQUE: "torque capacity",
    Tier.KINEMATIC: "shift time and slip",
}
"""What each tier yields, for people."""
LOCKUP_PURPOSE: Final[dict[Tier, str]] = {
    Tier.FRICTION: "friction of the lock-up clutch",
    Tier.TORQUE: "slope of friction of the lock-up clutch over slip, no level",
    Tier.KINEMATIC: "slip and shudder of the lock-up clutch",
}
"""The same of a vehicle with a torque converter."""


def is_of_lockup(signals: AbstractSet[Signal]) -> bool:
    """Return whether signals are those of a vehicle with a lock-up clutch."""
    return not signals.isdisjoint(SLIP_SIGNALS)


def reach_in_words(signals: AbstractSet[Signal], *, knows_gears: bool = False) -> str:
    """Return what tier signals reach and what it tells, for people."""
    has_converter = is_of_lockup(signals)
    tier = tier_of(signals, knows_gears=knows_gears, has_converter=has_converter)
    return f"tier {tier:d} ({(LOCKUP_PURPOSE if has_converter else PURPOSE)[tier]})" if tier else "no tier"


def tier_of(signals: AbstractSet[Signal], *, knows_gears: bool = False, has_converter: bool = False) -> Tier | None:
    """Return the best tier that the signals suffice for, or None if not even shifts can be found.

    ``knows_gears`` says that gears can be told from the ratio of speeds instead of gear signals; ``has_converter`` that
    it is about a lock-up clutch.
    """
    asked = {"knows_gears": knows_gears, "has_converter": has_converter}
    return next((tier for tier in Tier if not any(_unmet(tier, signals, **asked))), None)


def missing_for_next(signals: AbstractSet[Signal], *, knows_gears: bool = False, has_converter: bool = False) -> str:
    """Return one sentence: what the next better tier is and lacks; empty at the first tier."""
    tier = tier_of(signals, knows_gears=knows_gears, has_converter=has_converter)
    if tier is Tier.FRICTION:
        return ""
    if Signal.LOCKUP_PRESSURE in signals and not has_converter:
        return "friction of a lock-up clutch needs a description with its converter (--calibration lockup)"
    wanted = Tier.KINEMATIC if tier is None else Tier(tier - 1)
    return missing_for(wanted, signals, knows_gears=knows_gears, has_converter=has_converter)


def missing_for(wanted: Tier, signals: AbstractSet[Signal], *, knows_gears: bool, has_converter: bool) -> str:
    """Return one sentence: what a tier is and lacks."""
    purpose = (LOCKUP_PURPOSE if has_converter else PURPOSE)[wanted].removesuffix(", no level")
    missing = (
        " or ".join(listed(alternative, " and ") for alternative in requirement)
        for requirement in lacking(wanted, signals, knows_gears=knows_gears, has_converter=has_converter)
    )
    sentence = f"{purpose} {'need' if ' and ' in purpose else 'needs'} {', '.join(missing)}"
    is_commanded = Signal.LOCKUP_PRESSURE_COMMAND in signals and Signal.LOCKUP_PRESSURE not in signals
    if has_converter and is_commanded and wanted is Tier.FRICTION:
        sentence += " as measured: delay and scale of a commanded one are unknown, and the controller changes them"
    return sentence


def lacking(
    wanted: Tier, signals: AbstractSet[Signal], *, knows_gears: bool, has_converter: bool
) -> tuple[Requirement, ...]:
    """Return what a tier lacks: of each requirement that is not met what its alternatives lack, the least first."""
    unmet = _unmet(wanted, signals, knows_gears=knows_gears, has_converter=has_converter)
    lacks = [dict.fromkeys(frozenset(alternative - signals) for alternative in requirement) for requirement in unmet]
    least = ([each for each in every if not any(other < each for other in every)] for every in lacks)
    return tuple(tuple(sorted(alternatives, key=len)) for alternatives in least)


def why_no_friction(
    signals: AbstractSet[Signal], torque: TorqueSource, *, knows_gears: bool = False, has_converter: bool = False
) -> str:
    """Return one sentence: why there is no verdict on friction; empty at the first tier."""
    if (Signal.ENGINE_TORQUE not in signals or torque.is_modelled) and signals >= PRESSURES:
        return "engine torque is not measured, and without it the level of friction is known up to a scale at best"
    return missing_for_next(signals, knows_gears=knows_gears, has_converter=has_converter)


def _unmet(
    tier: Tier, signals: AbstractSet[Signal], *, knows_gears: bool, has_converter: bool
) -> Iterator[Requirement]:
    for requirement in (_LOCKUP_REQUIREMENTS if has_converter else _REQUIREMENTS)[tier]:
        if knows_gears and requirement[: len(_GEARS)] == _GEARS:
            continue
        if not any(alternative <= signals for alternative in requirement):
            yield requirement
