"""``diag-service try``: what a car tells whoever asks, by the profiles that ask, a first drive, and how to go on."""

import math
import shlex
import time
import uuid
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from enum import IntEnum
from heapq import heappop, heappush
from itertools import count
from operator import itemgetter
from pathlib import Path
from typing import Final

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
from diag_service.errors import ConfigError, ControllerError
from diag_service.mapping.asked_signals import NEGATIVE, data_in, sizes_of
from diag_service.mapping.interpretation import fit_of, open_database
from diag_service.mapping.mapped_messages import PURPOSE, fitting, missing_for_next, tier_of
from diag_service.mapping.profile import AskingRules, Profile, find_profile, load_shipped, shipped_profiles, to_si
from diag_service.settings.config import BusConfig
from diag_service.stopping import Controls
from workshop.tester.adapters import Line, line_through, parse_adapter, rules_through
from workshop.tester.addresses import CanAddress, id_text, is_extended
from workshop.tester.answers import refusal_text
from workshop.tester.asking import check_time, listen_at, opened_bus
from workshop.tester.listening import HeardTraffic
from workshop.tester.signal_asking import (
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

    def opened(profile: Profile) -> AbstractContextManager[Line]:
        if options.adapter is not None:
            return line_through(options.adapter, str(bus.channel), lambda: not controls.stop.is_set)
        return line_on(
            bus,
            [address_of(asked) for asked in profile.asked.values()],
            tuple(profile.groups.values()),
            is_fd=bus.is_fd,
            listen_s=options.listen,
            goes_on=lambda: not controls.stop.is_set,
        )

    database = None if options.dbc is None else open_database(options.dbc)
    profile = _best(profiles, opened, database, traffic, show)
    rules, groups = _rules(options, profile), tuple(profile.groups.values())
    with SignalAsker(profile.asked, rules, lambda: opened(profile), options.bitrate, groups) as asker:
        _measure(asker, options.listen, controls, show)
        if options.record is not None and not controls.stop.is_set:
            _record(asker, bus, options, controls, show)
    dbc = [] if options.dbc is None else ["--dbc", str(options.dbc)]
    words = ["--profile", str(options.profile or profile.name), *dbc]
    if options.record is not None:
        words += _judged(options.record, words, controls, show)
    show(f"go on with: {PROGRAM} run {shlex.join([*_place_words(options), *words])} --active")


def _best(
    profiles: list[Profile],
    opened: Callable[[Profile], AbstractContextManager[Line]],
    database: Database | None,
    traffic: HeardTraffic | None,
    show: Show,
) -> Profile:
    """Return the profile by which most can be diagnosed; raises ControllerError if nothing is told."""
    ranked: list[tuple[bool, float, int, int, Profile]] = []
    for profile in profiles:
        show(f"profile {profile.name}:")
        with opened(profile) as line:
            answered = _ask_each(line, profile, show)
        count = len(profile.asked) + len(profile.groups)
        tier, doubt, words = _reached(profile, answered, database, traffic)
        show(f"  {len(answered)} of {count} signals are told; {words}")
        if answered:
            ranked.append((doubt is Doubt.NONE_HEARD, tier or math.inf, -len(answered), doubt, profile))
    if not ranked:
        raise ControllerError("no controller tells what one of the profiles asks for: it may be asleep, or another one")
    return min(ranked, key=itemgetter(slice(4)))[-1]


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


def _ask_each(line: Line, profile: Profile, show: Show) -> frozenset[Signal]:
    """Ask for each signal once, and show what is told."""
    sizes, silent, answered = sizes_of(profile.asked.values()), set[CanAddress](), set[Signal]()
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
    UNKNOWN = 1  # its database is not named, or nothing can be heard
    NONE_HEARD = 2


def _reached(
    profile: Profile, answered: frozenset[Signal], database: Database | None, traffic: HeardTraffic | None
) -> tuple[Tier | None, Doubt, str]:
    """Return what the signals that are told suffice for, with those that a database says are broadcast."""
    broadcast = frozenset(profile.sources) - profile.asked.keys() - profile.groups.keys()
    messages, _ = fitting(database or load_contract(), profile)
    doubt = Doubt.UNKNOWN
    if traffic is None:
        broadcast = frozenset()
    elif messages or database is not None:
        is_heard = any(message.address.can_id in traffic.can_ids for message in messages)
        doubt = Doubt.HEARD if is_heard else Doubt.NONE_HEARD
    if database is not None:
        broadcast &= fit_of(database, profile).signals
    has_gears = profile.gears is not None
    tier = tier_of(answered | broadcast, knows_gears=has_gears)
    more = missing_for_next(answered | broadcast, knows_gears=has_gears)
    given = f" beside {len(broadcast)} that are broadcast" if broadcast else ""
    given += ", none of which was heard" if given and doubt is Doubt.NONE_HEARD else ""
    return tier, doubt, f"{PURPOSE[tier] if tier is not None else 'nothing yet'}{given}{f'; {more}' if more else ''}"


def _measure(asker: SignalAsker, listen_s: float, controls: Controls, show: Show) -> None:
    """Show how fast a profile is told."""
    until_s = time.monotonic() + listen_s + RATE_S
    while not asker.set_count and time.monotonic() < until_s and not controls.stop.is_set:
        time.sleep(0.05)
    begun_s, count = time.monotonic(), asker.set_count
    while time.monotonic() < begun_s + RATE_S and not controls.stop.is_set:
        time.sleep(0.05)
    show(f"{(asker.set_count - count) / (time.monotonic() - begun_s):.0f} sets a second")
