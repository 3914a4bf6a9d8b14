"""``diag-service try``: what a car tells whoever asks, by the profiles that ask, and how to go on."""

import time
import uuid
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from types import SimpleNamespace
from typing import Final

import numpy as np
from cantools.database.can import Database

from diag_service.console.terminal import PeopleConsole
from diag_service.diagnosis.columns import Signal
from diag_service.errors import ConfigError, ControllerError
from diag_service.mapping.asked_signals import NEGATIVE, data_in, sizes_of
from diag_service.mapping.databases import open_database
from diag_service.mapping.interpretation import fit_of
from diag_service.mapping.profile import Profile, find_profile, load_shipped, shipped_profiles, to_si
from diag_service.mapping.tiers import PURPOSE, missing_for_next, tier_of
from diag_service.service.stopping import Controls
from diag_service.tester.adapters import Line, line_through, parse_adapter
from diag_service.tester.addresses import CanAddress, id_text
from diag_service.tester.answers import refusal_text
from diag_service.tester.asking import BusName, check_time, heard
from diag_service.tester.signal_asking import Plan, SignalAsker, line_on

RATE_S: Final = 5.0
LEAST_LISTEN_S: Final = 0.0
_ROUND: Final = 4  # significant digits of a value that is shown
Show = Callable[[str], object]


def try_car(options: SimpleNamespace, controls: Controls) -> None:
    """Listen, try the profiles that ask, and say what was found; sends nothing without ``--active``."""
    show: Show = PeopleConsole().print
    check_time("--listen", options.listen, least_s=LEAST_LISTEN_S)
    profiles = _profiles(options.profile)
    adapter = options.adapter
    _check_adapter(options)
    bus = BusName(interface=options.interface, channel=options.channel, bitrate=options.bitrate, is_fd=options.fd)
    if adapter is None:
        show(str(heard(bus, options.listen, lambda: not controls.stop.is_set)))
    if not options.active:
        for profile in profiles:
            asked = ", ".join(dict.fromkeys(str(one.data_id) for one in profile.asked.values()))
            show(f"{profile.name} would ask for {asked}")
        show("nothing was sent; with --active these questions are asked, by services 22, 01 and 21 alone")
        return

    def opened(profile: Profile) -> AbstractContextManager[Line]:
        if adapter is not None:
            return line_through(adapter, f"try {uuid.uuid4()}", lambda: not controls.stop.is_set)
        fields = profile.asked.values()
        addresses = [CanAddress(request_id=one.request_id, response_id=one.reply_id) for one in fields]
        return line_on(
            bus, addresses, is_fd=bus.is_fd, listen_s=options.listen, goes_on=lambda: not controls.stop.is_set
        )

    database = None if options.dbc is None else open_database(options.dbc, is_lenient=options.lenient)
    best: tuple[int, Profile] | None = None
    for profile in profiles:
        show(f"profile {profile.name}:")
        with opened(profile) as line:
            told = _told(line, profile, show)
        show(f"  {len(told)} of {len(profile.asked)} signals are told; {_reached(profile, told, database)}")
        if told and (best is None or len(told) > best[0]):
            best = len(told), profile
    if best is None:
        raise ControllerError("no controller tells what one of the profiles asks for: it may be asleep, or another one")
    profile = best[1]
    with SignalAsker(profile.asked, profile.asking.together, lambda: opened(profile), options.bitrate) as asker:
        _measure(asker, options.listen, controls, show)
    show(_way_on(options, profile))


def _check_adapter(options: SimpleNamespace) -> None:
    if options.adapter is None:
        return
    parse_adapter(options.adapter)
    if options.interface is not None or options.channel is not None:
        raise ConfigError("give either --adapter or --interface and --channel")


def _way_on(options: SimpleNamespace, profile: Profile) -> str:
    """Return the command that diagnoses what was tried."""
    words = ["--adapter", options.adapter] if options.adapter is not None else []
    for option, value in (("-i", options.interface), ("-c", options.channel), ("--dbc", options.dbc)):
        words += [] if value is None else [option, str(value)]
    return f"go on with: diag-service run {' '.join(words)} --profile {options.profile or profile.name} --active"


def _profiles(named: Path | None) -> list[Profile]:
    profiles = [find_profile(named)] if named is not None else [load_shipped(name) for name in shipped_profiles()]
    if not (asking := [one for one in profiles if one.asked]):
        raise ConfigError(f"profile {named} asks for nothing: try is for profiles that do")
    return asking


def _told(line: Line, profile: Profile, show: Show) -> frozenset[Signal]:
    """Ask for each signal once, and show what is told."""
    sizes, silent, told = sizes_of(profile.asked.values()), set[CanAddress](), set[Signal]()
    for signal, asked in profile.asked.items():
        (question,) = Plan({signal: asked}, 1).due(0.0)
        if question.address in silent:
            continue
        answer = line.ask(question.request, question.address)
        if answer is None:
            silent.add(question.address)
            show(f"  {id_text(asked.request_id)} does not answer")
            continue
        if answer[0] == NEGATIVE:
            show(f"  {signal.value}: {question} is refused, {refusal_text(answer[2] if len(answer) > 2 else 0)}")
            continue
        found = data_in(question.request, answer, asked.request_id, sizes)
        if isinstance(found, str) or asked.data_id not in dict(found):
            show(f"  {signal.value}: {question} is not told: {found if isinstance(found, str) else 'left out'}")
            continue
        raw = asked.value(dict(found)[asked.data_id])
        value = float(to_si(signal, profile.sources[signal], None)(np.array([float(raw)]))[0])
        show(f"  {signal.value} = {value:.{_ROUND}g} ({question})")
        told.add(signal)
    return frozenset(told)


def _reached(profile: Profile, told: frozenset[Signal], database: Database | None) -> str:
    """Return what the signals that are told suffice for, with those that a database says are broadcast."""
    broadcast = frozenset(signal for signal in profile.sources if signal not in profile.asked)
    if database is not None:
        broadcast &= fit_of(database, profile).signals
    has_gears = profile.gears is not None
    tier = tier_of(told | broadcast, knows_gears=has_gears)
    more = missing_for_next(told | broadcast, knows_gears=has_gears)
    given = f" beside {len(broadcast)} that are broadcast" if broadcast else ""
    return f"{PURPOSE[tier] if tier is not None else 'nothing yet'}{given}{f'; {more}' if more else ''}"


def _measure(asker: SignalAsker, listen_s: float, controls: Controls, show: Show) -> None:
    """Show how fast a profile is told."""
    until_s = time.monotonic() + listen_s + RATE_S
    while not asker.set_count and time.monotonic() < until_s and not controls.stop.is_set:
        time.sleep(0.05)
    begun_s, count = time.monotonic(), asker.set_count
    while time.monotonic() < begun_s + RATE_S and not controls.stop.is_set:
        time.sleep(0.05)
    show(f"{(asker.set_count - count) / (time.monotonic() - begun_s):.0f} sets a second")
