"""``diag-service try``: what a car tells whoever asks, by the profiles that ask, a first drive, and how to go on."""

import shlex
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from cantools.database.can import Database

from clutchdiag_io.console import PeopleConsole
from diag_service.commands.options import PROGRAM
from diag_service.console import ReadingLine
from diag_service.errors import ConfigError, ControllerError, StoppedError
from diag_service.mapping.asked_signals import sizes_of
from diag_service.mapping.interpretation import open_database
from diag_service.mapping.profile import AskingRules, Profile, find_profile, load_shipped, shipped_profiles
from diag_service.settings.config import BusConfig
from diag_service.stopping import Controls
from workshop.tester.access import AdapterAccess, BusAccess, CarAccess
from workshop.tester.addresses import id_text
from workshop.tester.asking import check_time
from workshop.tester.car_trial import CarTrial
from workshop.tester.first_drive import check_log, judge, record
from workshop.tester.interview import AskOutcome, Interview, Show
from workshop.tester.listening import HeardTraffic
from workshop.tester.signal_asking import PollPlan, SignalAsker, address_of

RATE_S: Final = 5.0


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
    patience: float
    record: Path | None
    duration: float | None


def try_car(options: TryOptions, controls: Controls) -> None:
    """Listen, try the profiles that ask, and say what the car answers; sends nothing without ``--active``, or dry."""
    show: Show = PeopleConsole().print
    check_time("listen", options.listen, least_s=0.0)
    check_time("patience", options.patience, least_s=0.0)
    _check_recording(options)
    access, profiles = _access(options), _profiles(options.profile)
    database = None if options.dbc is None else open_database(options.dbc)
    traffic = access.listen(options.listen, lambda: not controls.stop.is_set)
    if traffic is not None:
        show(str(traffic))
    profiles = access.usable(profiles, traffic)
    if options.dry_run or not options.active:
        _show_requests(access, profiles, show, has_details=options.dry_run or controls.verbosity > 0)
        return
    trial = _tried(profiles, access, database, traffic, options, controls, show)
    named = ["--profile", str(options.profile or trial.profile.name)]
    named += ["--dbc", str(options.dbc)] if options.dbc is not None and trial.broadcast else []
    _measure(trial, access, options, controls, show)
    if options.record is not None:
        named += judge(trial.transmission, options.record, named, controls, show)
    show(f"go on with: {PROGRAM} run {shlex.join([*access.words, *named])} --active")


def _tried(
    profiles: Sequence[Profile],
    access: CarAccess,
    database: Database | None,
    traffic: HeardTraffic | None,
    options: TryOptions,
    controls: Controls,
    show: Show,
) -> CarTrial:
    """Return and show the trial of the profile by which most can be diagnosed.

    Raises ControllerError if no drive would tell anything; SourceError, StoppedError.
    """
    goes_on = lambda: not controls.stop.is_set  # noqa: E731 - of two that wait
    trials, others = list[CarTrial](), () if traffic is None else traffic.other_testers()
    if others:
        show(f"another tester asks on {', '.join(map(id_text, others))}: waiting until it is silent")
    with access.opened(profiles, options.listen if others else 0.0, goes_on) as line, ReadingLine() as reading:

        def tell(text: str) -> None:
            reading.clear()
            show(text)

        interview = Interview(line, options.patience, tell, goes_on)
        for profile in profiles:
            reading.tell(f"asking by profile {profile.name}")
            trials.append(trial := CarTrial.of(profile, list(interview.replies(profile)), database, traffic))
            if controls.verbosity:
                tell("\n  ".join([f"profile {profile.name}, {trial.count_words} values:", *map(str, trial.replies)]))
    best = min(trials, key=lambda trial: trial.rank)
    if not best.is_enough:
        _check_answers(interview, trials, traffic)
    show(best.summary())
    if less := [f"{trial.profile.name} ({trial.count_words})" for trial in trials if trial is not best]:
        show(f"other profiles tell less: {', '.join(less)}{'' if controls.verbosity else '; -v shows the answers'}")
    best.check()
    return best


def _measure(trial: CarTrial, access: CarAccess, options: TryOptions, controls: Controls, show: Show) -> None:
    """Measure how fast a car answers, show what a drive will tell, and record one if that is wanted."""
    with SignalAsker(
        trial.profile.asked,
        access.rules(trial.profile),
        lambda: access.opened([trial.profile], options.listen, lambda: not controls.stop.is_set),
        options.bitrate,
        tuple(trial.profile.groups.values()),
    ) as asker:
        show(trial.promise(_rate_hz(asker, options.listen, controls)))
        if options.record is not None and not controls.stop.is_set:
            until = "until Ctrl-C" if options.duration is None else f"for {options.duration:g} s"
            show(f"drive now, {trial.transmission.route}: recorded into {options.record} {until}")
            record(asker, access.bus, options.record, options.duration, controls, show)


def _rate_hz(asker: SignalAsker, listen_s: float, controls: Controls) -> float:
    """Return how fast all values come [sets/s]; raises StoppedError."""
    until_s = time.monotonic() + listen_s + RATE_S
    while not asker.set_count and time.monotonic() < until_s and not controls.stop.is_set:
        time.sleep(0.05)
    begun_s, count = time.monotonic(), asker.set_count
    while time.monotonic() < begun_s + RATE_S:
        if controls.stop.is_set:
            raise StoppedError("stopped early: nothing was measured")
        time.sleep(0.05)
    return (asker.set_count - count) / (time.monotonic() - begun_s)


def _check_answers(interview: Interview, trials: Sequence[CarTrial], traffic: HeardTraffic | None) -> None:
    """Raise ControllerError if controllers were busy, or none answers anything."""
    late = {
        address: outcome
        for address, outcome in interview.given_up.items()
        if outcome in {AskOutcome.BUSY, AskOutcome.UNFINISHED}
    }
    for address, outcome in late.items():
        what = f"stayed busy for {interview.patience_s:g} s" if outcome is AskOutcome.BUSY else outcome
        next_step = "wait a minute with the ignition on, and try again"
        raise ControllerError(f"{id_text(address.request_id)} {what}; it may be starting: {next_step}")
    if any(trial.answered for trial in trials):
        return
    asked = {address_of(field) for trial in trials for field in trial.profile.asked.values()}
    answering = asked - interview.given_up.keys()
    ids = ", ".join(id_text(can_id) for can_id in sorted({address.request_id for address in answering or asked}))
    if not answering:
        heard = "nothing is said on the bus, and " if traffic is not None and not traffic.frame_count else ""
        raise ControllerError(
            f"{heard}nobody answers at {ids}: switch the ignition on, check plug and bit rate, and try again"
        )
    raise ControllerError(f"{ids} answers, but tells nothing that a profile asks for: --profile names one of your own")


def _show_requests(access: CarAccess, profiles: Sequence[Profile], show: Show, *, has_details: bool) -> None:
    """Show what ``--active`` would send."""
    for profile in profiles if has_details else ():
        _show_requests_of(profile, access.rules(profile), show)
    defines = any(access.rules(profile).define for profile in profiles)
    what = "reading services, and 2C, which makes a datum of others" if defines else "reading services alone"
    names = ", ".join(profile.name for profile in profiles)
    more = "" if has_details else "; --dry-run shows them byte by byte"
    show(f"nothing was sent; --active sends requests by {names}: {what}{more}")


def _show_requests_of(profile: Profile, rules: AskingRules, show: Show) -> None:
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


def _check_recording(options: TryOptions) -> None:
    if options.record is None:
        if options.duration is not None:
            raise ConfigError("--duration is for --record")
        return
    if not options.active and not options.dry_run:
        raise ConfigError("--record needs --active: what is not asked for is not told")
    check_log(options.record)


def _access(options: TryOptions) -> CarAccess:
    if options.adapter is None:
        bus = BusConfig(interface=options.interface, channel=options.channel, bitrate=options.bitrate, is_fd=options.fd)
        return BusAccess(bus=bus)
    if options.interface is not None or options.channel is not None:
        raise ConfigError("give either --adapter or --interface and --channel")
    return AdapterAccess(url=options.adapter)


def _profiles(named: Path | None) -> list[Profile]:
    profiles = [find_profile(named)] if named is not None else [load_shipped(name) for name in shipped_profiles()]
    if not (asking := [profile for profile in profiles if profile.asked or profile.groups]):
        raise ConfigError(f"profile {named} asks for nothing: try is for profiles that do")
    return asking
