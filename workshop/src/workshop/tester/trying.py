"""``diag-service try``: what a car tells whoever asks, by the profiles that ask, a first drive, and how to go on."""

import math
import shlex
import time
import uuid
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from enum import IntEnum
from heapq import heappop, heappush
from itertools import count
from pathlib import Path
from typing import Final, Self

import can
import numpy as np
from cantools.database.can import Database

from canlog.errors import OutputError, SourceError
from clutch_model.units import for_people
from clutch_results.records import Tier
from clutchdiag_io.console import PeopleConsole
from clutchdiag_io.people import digits
from clutchdiag_io.program import replacement_refusal
from dbc.contract import load_contract
from diag_service.cli import command_line
from diag_service.commands.options import PROGRAM
from diag_service.diagnosis.columns import Signal
from diag_service.errors import ConfigError, ControllerError, StoppedError
from diag_service.mapping.asked_signals import NEGATIVE, data_in, sizes_of
from diag_service.mapping.interpretation import fit_of, open_database
from diag_service.mapping.mapped_messages import (
    LOCKUP_PURPOSE,
    PURPOSE,
    fitting,
    is_of_lockup,
    missing_for,
    missing_for_next,
    reach_in_words,
    tier_of,
)
from diag_service.mapping.profile import AskingRules, Profile, find_profile, load_shipped, shipped_profiles, to_si
from diag_service.settings.config import BusConfig
from diag_service.stopping import Controls
from workshop.tester.adapters import Line, line_through, parse_adapter, rules_through
from workshop.tester.addresses import CanAddress, id_text, is_extended
from workshop.tester.answers import refusal_text
from workshop.tester.asking import check_time, listen_at, opened_bus
from workshop.tester.listening import HeardTraffic
from workshop.tester.signal_asking import (
    LEAST_ROWS,
    MOST_SILENT,
    NO_GROUPS,
    CanLine,
    DataRequest,
    GroupQuestion,
    PollPlan,
    SignalAsker,
    address_of,
    line_on,
)

RATE_S: Final = 5.0
PROGRESS_S: Final = 60.0  # from line to line while a drive is recorded
LOOK_S: Final = 0.1
HELD_S: Final = 0.5  # frames of several senders come out of order by less
LOGS: Final = (".log", ".asc", ".blf")  # python-can writes them, and they are read again
LEAST_SETS_HZ: Final = 1.0  # the longest launches slip for some five seconds, and an estimate needs five rows
SHUDDER_SETS_HZ: Final = 25.0  # shudder swings 5 to 12 times a second
_KINDS: Final = {"speeds": ("_rad_s", "_m_s"), "torque": ("_nm",), "pressures": ("_pa",)}  # by ends of names
_BY_RATE: Final = (  # [sets/s]; emulated, city: at 14 no shift counted, at 24 both clutches became known
    (20.0, "of shifts and launches: level and changes of both clutches from the second drive on"),
    (5.0, "of launches alone: level and changes of clutch 1 from the second drive on, clutch 2 unknown"),
    (0.0, "of launches alone: changes of clutch 1 from the third drive on, no verdict on level, clutch 2 unknown"),
)
Show = Callable[[str], object]


@dataclass(frozen=True, slots=True, kw_only=True)
class TryOptions:
    """Which car is tried, and how far that goes."""

    interface: str | None
    channel: str | None
    bitrate: int | None
    fd: bool
    adapter: str | None
    profile: Path | None
    dbc: Path | None
    active: bool
    dry_run: bool
    listen: float
    record: Path | None
    duration: float | None


def try_car(options: TryOptions, controls: Controls) -> None:
    """Listen, try the profiles that ask, and say what was found; sends nothing without ``--active``, or dry."""
    show: Show = PeopleConsole().print
    check_time("listen", options.listen, least_s=0.0)
    _check_recording(options)
    _check_adapter(options)
    profiles = _profiles(options.profile)
    bus = BusConfig(interface=options.interface, channel=options.channel, bitrate=options.bitrate, is_fd=options.fd)
    traffic = None  # through an adapter nothing is heard that was not asked for
    if options.adapter is None:
        show(str(traffic := listen_at(bus, options.listen, lambda: not controls.stop.is_set)))
        if traffic is not None and not any(map(is_extended, traffic.can_ids)) and options.profile is None:
            profiles = [profile for profile in profiles if not profile.groups]  # no J1939 on a bus of 11-bit frames
    else:
        bus = BusConfig(interface="virtual", channel=f"try-{uuid.uuid4()}", bitrate=None, is_fd=False)
        if not (profiles := [profile for profile in profiles if not profile.groups]):
            raise ConfigError(NO_GROUPS)
    if options.dry_run or not options.active:
        for profile in profiles:
            _show_requests(profile, _rules(options, profile), show)
        defines = any(_rules(options, profile).define for profile in profiles)
        what = "reading services, and 2C, which makes a datum of others" if defines else "reading services alone"
        show(f"nothing was sent; --active sends these: {what}")
        return

    def opened(asked: Sequence[Profile], listen_s: float) -> AbstractContextManager[Line]:
        if options.adapter is not None:
            return line_through(options.adapter, str(bus.channel), lambda: not controls.stop.is_set)
        return line_on(
            bus,
            [address_of(field) for profile in asked for field in profile.asked.values()],
            [pgn for profile in asked for pgn in profile.groups.values()],
            is_fd=bus.is_fd,
            listen_s=listen_s,
            goes_on=lambda: not controls.stop.is_set,
        )

    database = None if options.dbc is None else open_database(options.dbc)
    is_alone = traffic is not None and not traffic.other_testers()
    with opened(profiles, 0.0 if is_alone else options.listen) as line:
        trial = _best(profiles, line, database, traffic, show)
    profile = trial.profile
    rules, groups = _rules(options, profile), tuple(profile.groups.values())
    with SignalAsker(profile.asked, rules, lambda: opened([profile], options.listen), options.bitrate, groups) as asker:
        show(trial.reach(_measure(asker, options.listen, controls)))
        if options.record is not None and not controls.stop.is_set:
            _record(asker, bus, options, controls, show)
    dbc = [] if options.dbc is None or not trial.broadcast else ["--dbc", str(options.dbc)]
    words = ["--profile", str(options.profile or profile.name), *dbc]
    if options.record is not None:
        words += _judged(options.record, words, controls, show)
    show(f"go on with: {PROGRAM} run {shlex.join([*_place_words(options), *words])} --active")


def _best(
    profiles: Sequence[Profile], line: Line, database: Database | None, traffic: HeardTraffic | None, show: Show
) -> "CarTrial":
    """Return the trial of the profile by which most can be diagnosed; raises ControllerError if nothing is told."""
    trials, silent = list[CarTrial](), set[CanAddress]()
    for profile in profiles:
        show(f"profile {profile.name}:")
        trial = CarTrial.of(profile, _ask_each(line, profile, silent, show), database, traffic)
        show(f"  {len(trial.answered)} of {len(profile.asked) + len(profile.groups)} signals are told; {trial}")
        trials += [trial] if trial.answered else []
    if trials:
        return min(trials, key=lambda trial: trial.rank)
    if silent and all(address_of(field) in silent for profile in profiles for field in profile.asked.values()):
        ids = ", ".join(id_text(can_id) for can_id in sorted({address.request_id for address in silent}))
        heard = "nothing is said on the bus, and " if traffic is not None and not traffic.frame_count else ""
        raise ControllerError(
            f"{heard}nobody answers at {ids}: switch the ignition on, check plug and bit rate, and try again"
        )
    raise ControllerError("no controller tells what one of the profiles asks for: --profile names one of your own")


def _show_requests(profile: Profile, rules: AskingRules, show: Show) -> None:
    """Show the requests of a first round, byte by byte."""
    plan, sizes = PollPlan(profile.asked, rules, tuple(profile.groups.values())), sizes_of(profile.asked.values())
    show(f"{profile.name} would ask for {', '.join(map(str, plan.due(0.0)))}:")
    plan = PollPlan(profile.asked, rules, plan.groups)
    plan.defined |= plan.definitions() if rules.define else {}
    requests = [
        (definition.address.request_id, request)
        for datum, definition in plan.defined.items()
        for request in (definition.forgetting(datum.number), definition.request(datum.number, sizes))
    ]
    requests += [(question.can_id, question.request) for question in plan.due(0.0)]
    for can_id, request in requests:
        show(f"  {id_text(can_id)}: {request.hex(' ').upper()}")


def _rules(options: TryOptions, profile: Profile) -> AskingRules:
    return profile.asking if options.adapter is None else rules_through(options.adapter, profile.asking)


def _check_recording(options: TryOptions) -> None:
    if options.record is None:
        if options.duration is not None:
            raise ConfigError("--duration is for --record")
        return
    if not options.active and not options.dry_run:
        raise ConfigError("--record needs --active: what is not asked for is not told")
    if options.record.suffix not in LOGS:
        raise ConfigError(f"--record {options.record}: a log ends with {', '.join(LOGS)}")
    for path in (options.record, description_path(options.record)):
        if text := replacement_refusal(path, is_forced=False):
            raise ConfigError(text)


def description_path(log: Path) -> Path:
    """Return where the description that a log teaches is written: beside it."""
    return log.with_suffix(".vehicle.toml")


class InOrder(can.Listener):
    """Writes the frames of a bus into a log in the order of their times, which several senders do not keep."""

    def __init__(self, log: can.Listener) -> None:
        self._log = log
        self._held: list[tuple[float, int, can.Message]] = []
        self._count = count()

    def on_message_received(self, msg: can.Message) -> None:
        heappush(self._held, (msg.timestamp, next(self._count), msg))
        while self._held[0][0] < msg.timestamp - HELD_S:
            self._log.on_message_received(heappop(self._held)[2])

    def on_error(self, exc: Exception) -> None:
        """Say nothing: who records looks at what the notifier keeps."""

    def stop(self) -> None:
        while self._held:
            self._log.on_message_received(heappop(self._held)[2])
        self._log.stop()


def _record(asker: SignalAsker, bus: BusConfig, options: TryOptions, controls: Controls, show: Show) -> None:
    """Write what is said on a bus into a log while a car is driven and asked; raises OutputError, SourceError."""
    path, end_s = options.record, time.monotonic() + (options.duration or float("inf"))
    until = "until Ctrl-C" if options.duration is None else f"for {options.duration:g} s"
    show(f"drive now, with gear changes of all gears, pulled and coasted: recorded into {path} {until}")
    try:
        log = can.Logger(path)
        with opened_bus(bus) as heard_bus, can.Notifier(heard_bus, [InOrder(log)]) as reader:
            begun_s = told_s = time.monotonic()
            while not controls.stop.is_set and (now_s := time.monotonic()) < end_s:
                if reader.exception is not None:
                    raise reader.exception
                if now_s > told_s + PROGRESS_S:
                    told_s = now_s
                    show(f"{(now_s - begun_s) / 60.0:.0f} min, {asker.set_count} sets")
                time.sleep(LOOK_S)
    except OSError as exc:
        raise OutputError(f"cannot record into {path}: {exc.strerror or exc}") from exc
    except can.CanError as exc:
        raise SourceError(f"recording into {path} ended: {exc}") from exc


def _judged(log: Path, words: list[str], controls: Controls, show: Show) -> list[str]:
    """Learn the vehicle from its first drive and diagnose it; return the words that name what was learned.

    Each is the command that a person could type. A Ctrl-C that ended the drive does not end this; the next one does.
    """
    controls.stop.rearm()
    description, named = description_path(log), list[str]()
    try:
        _typed(["learn", str(log), *words, "-o", str(description)], controls, show)
        named = ["--vehicle-file", str(description)]
    except ConfigError as exc:
        show(str(exc))
    _typed(["analyze", str(log), *words, *named], controls, show)
    return named


def _typed(words: list[str], controls: Controls, show: Show) -> None:
    show(f"$ {PROGRAM} {shlex.join(words)}")
    command_line.main(words, PROGRAM, standalone_mode=False, obj=controls)


def _check_adapter(options: TryOptions) -> None:
    if options.adapter is None:
        return
    parse_adapter(options.adapter)
    if options.interface is not None or options.channel is not None:
        raise ConfigError("give either --adapter or --interface and --channel")


def _place_words(options: TryOptions) -> list[str]:
    words = ["--adapter", options.adapter] if options.adapter is not None else []
    for option, value in (("-i", options.interface), ("-c", options.channel), ("-b", options.bitrate)):
        words += [] if value is None else [option, str(value)]
    return [*words, "--fd"] if options.fd else words


def _profiles(named: Path | None) -> list[Profile]:
    profiles = [find_profile(named)] if named is not None else [load_shipped(name) for name in shipped_profiles()]
    if not (asking := [profile for profile in profiles if profile.asked or profile.groups]):
        raise ConfigError(f"profile {named} asks for nothing: try is for profiles that do")
    return asking


def _ask_each(line: Line, profile: Profile, silent: set[CanAddress], show: Show) -> frozenset[Signal]:
    """Ask for each signal once of who is not known to be silent, and show what is told."""
    sizes, answered = sizes_of(profile.asked.values()), set[Signal]()
    for signal, asked in profile.asked.items():
        question = DataRequest(address_of(asked), (asked.data_id,))
        if question.address in silent:
            continue
        answers = (line.ask(question.request, question.address) for _ in range(MOST_SILENT))
        answer = next((reply for reply in answers if reply is not None), None)
        if answer is None:
            silent.add(question.address)
            show(f"  {id_text(asked.request_id)} does not answer")
            continue
        if answer[0] == NEGATIVE:
            show(f"  {signal.value}: {question} is refused, {refusal_text(answer[2] if len(answer) > 2 else 0)}")
            continue
        data = data_in(question.request, answer, asked.request_id, sizes)
        if isinstance(data, str) or asked.data_id not in dict(data):
            show(f"  {signal.value}: {question} is not told: {data if isinstance(data, str) else 'left out'}")
            continue
        raw = asked.value(dict(data)[asked.data_id])
        if raw in profile.sources[signal].invalid:
            show(f"  {signal.value} has no value now ({question})")
            answered.add(signal)
            continue
        value = float(to_si(signal, profile.sources[signal], None)(np.array([float(raw)]))[0])
        name, amount, unit = for_people(signal.value, value)
        show(f"  {name} = {f'{digits(amount)} {unit}'.rstrip()} ({question})")
        answered.add(signal)
    for signal, pgn in profile.groups.items():
        group = GroupQuestion(pgn)
        if isinstance(line, CanLine) and line.ask_group(group) is not None:
            answered.add(signal)
        show(f"  {signal.value}: {group} is {'' if signal in answered else 'not '}told")
    return frozenset(answered)


class Doubt(IntEnum):
    """Whether what a profile says is broadcast can be."""

    HEARD = 0
    UNKNOWN = 1  # it needs nothing that is broadcast, or nothing can be heard
    NONE_HEARD = 2


@dataclass(frozen=True, slots=True, kw_only=True)
class CarTrial:
    """What a car tells by one profile: signals that were asked for, and those that a database says are broadcast."""

    profile: Profile
    answered: frozenset[Signal]
    broadcast: frozenset[Signal]
    doubt: Doubt

    @classmethod
    def of(
        cls, profile: Profile, answered: frozenset[Signal], database: Database | None, traffic: HeardTraffic | None
    ) -> Self:
        broadcast, doubt = frozenset(profile.sources) - profile.asked.keys() - profile.groups.keys(), Doubt.UNKNOWN
        messages, _ = fitting(database or load_contract(), profile)
        if traffic is None:
            broadcast = frozenset()
        elif messages or (database is not None and not profile.is_of_columns):
            is_heard = any(message.address.can_id in traffic.can_ids for message in messages)
            doubt = Doubt.HEARD if is_heard else Doubt.UNKNOWN if profile.is_of_columns else Doubt.NONE_HEARD
        broadcast &= fit_of(database or open_database(profile.database), profile).signals
        return cls(profile=profile, answered=answered, broadcast=broadcast, doubt=doubt)

    @property
    def signals(self) -> frozenset[Signal]:
        return self.answered if self.doubt is Doubt.NONE_HEARD else self.answered | self.broadcast

    @property
    def conditions(self) -> dict[str, bool]:
        """What tiers are asked with: a drive teaches the ratios of gears by two speeds."""
        speeds = {Signal.VEHICLE_SPEED, Signal.OUTPUT_SPEED}
        teaches = Signal.ENGINE_SPEED in self.signals and not speeds.isdisjoint(self.signals)
        return {
            "knows_gears": teaches or self.profile.gears is not None,
            "has_converter": is_of_lockup(self.profile.sources.keys()),
        }

    @property
    def tier(self) -> Tier | None:
        return tier_of(self.signals, **self.conditions)

    @property
    def rank(self) -> tuple[bool, float, int, int]:
        """By which the best is the least."""
        return self.doubt is Doubt.NONE_HEARD, self.tier or math.inf, self.doubt, -len(self.answered)

    def __str__(self) -> str:
        """Return what its signals suffice for, and what the next tier lacks."""
        reached = reach_in_words(self.signals, knows_gears=self.conditions["knows_gears"])
        beside = f" beside {len(self.broadcast)} that are broadcast" if self.broadcast else ""
        beside += ", none of which was heard" if beside and self.doubt is Doubt.NONE_HEARD else ""
        more = missing_for_next(self.signals, **self.conditions)
        return f"{reached}{beside}{f'; {more}' if more else ''}"

    def reach(self, rate_hz: float) -> str:
        """Return what a drive will tell by so many sets a second; raises ControllerError if that is not worth it."""
        tier, has_converter = self.tier, self.conditions["has_converter"]
        kinds = [kind for kind, ends in _KINDS.items() if any(signal.value.endswith(ends) for signal in self.signals)]
        reached = f"{', '.join(kinds)} at {rate_hz:.2g} sets a second"
        if tier is None or tier is Tier.KINEMATIC:
            needs = missing_for(Tier.TORQUE if has_converter else Tier.FRICTION, self.signals, **self.conditions)
            raise ControllerError(f"{reached}: no drive tells anything of friction; {needs}")
        if rate_hz < LEAST_SETS_HZ:
            raise ControllerError(f"{reached}: too slow for any drive; it takes {LEAST_SETS_HZ:g}, by another adapter")
        if has_converter:
            shudder = "" if rate_hz >= SHUDDER_SETS_HZ else f"; no shudder, which takes {SHUDDER_SETS_HZ:g}"
            return f"{reached}: {LOCKUP_PURPOSE[tier]}{shudder}"
        slips = f"slips of {LEAST_ROWS / rate_hz:.2g} s and longer"
        return f"{reached}: {PURPOSE[tier]} by {slips} {next(text for least, text in _BY_RATE if rate_hz >= least)}"


def _measure(asker: SignalAsker, listen_s: float, controls: Controls) -> float:
    """Return how fast a profile is told [sets/s]; raises StoppedError."""
    until_s = time.monotonic() + listen_s + RATE_S
    while not asker.set_count and time.monotonic() < until_s and not controls.stop.is_set:
        time.sleep(0.05)
    begun_s, count = time.monotonic(), asker.set_count
    while time.monotonic() < begun_s + RATE_S:
        if controls.stop.is_set:
            raise StoppedError("stopped early: nothing was measured")
        time.sleep(0.05)
    return (asker.set_count - count) / (time.monotonic() - begun_s)
