"""How a recorded drive is read: which mapped signals live, what tier that makes, whether another profile fits better.

One decision for everybody who reads logs: `analyze`, `report`, `signals`, and tables of many logs. `decision_of` reads
the drive once, but no further than until every signal that could be found still has moved.
"""

from collections.abc import Callable, Iterator, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from cantools.database.can import Database

from canlog.database.addressing import NOBODY, address_book, find_slots
from canlog.errors import InputLeftError
from canlog.files import is_plain_file
from canlog.logs.streams import never
from clutch_model.calibration import Calibration, TorqueSource
from clutch_results.records import Tier
from diag_service.diagnosis.columns import SUMMED_SIGNALS, ColumnBatch, Signal
from diag_service.mapping.decoder import Decoder
from diag_service.mapping.interpretation import Interpretation, open_database
from diag_service.mapping.learning import BEHIND, VehicleSurvey
from diag_service.mapping.liveness import LEAST_RECORDED, Liveness, StillSignal
from diag_service.mapping.mapped_messages import fitting, is_of_lockup, missing_for_next, tier_of
from diag_service.mapping.profile import Profile, load_shipped, shipped_profiles
from diag_service.service.drive import DriveFrames, open_drive
from diag_service.settings.config import DiagnosisConfig
from diag_service.settings.options import as_proposed


@dataclass(frozen=True, slots=True, kw_only=True)
class LogLook:
    """What a first reading of a drive found."""

    liveness: Liveness  # of the mapped signals
    heard_ids: frozenset[int] = frozenset()  # identifiers of the frames, with their flags
    received: frozenset[Signal] = frozenset()  # mapped signals of which a value came
    is_of_columns: bool = False  # a table of signals, which has no identifiers
    is_of_whole: bool = True  # whether the drive was looked at


@dataclass(frozen=True, slots=True, kw_only=True)
class LogDecision:
    """How a drive is read, and what that makes of it."""

    meaning: Interpretation  # to read it with: without what is absent, with gears by ratios where no signal tells them
    named: frozenset[Signal]  # canonical signals that the profile names and the database or table has
    alive: frozenset[Signal]  # of them those that came, and stand still nowhere where physics demands motion
    still: tuple[StillSignal, ...] = ()  # those that do: taken as absent
    tier: Tier | None = None  # what `alive` suffices for; None: not even shifts can be found
    missing: str = ""  # a sentence: what the next better tier needs; empty at the first
    has_converter: bool = False  # whether it is about a lock-up clutch
    better: str = ""  # a sentence: which shipped profile fits the log better; empty if none does
    is_of_whole: bool = True  # whether the drive was looked at; what comes through a pipe is not
    absences: tuple[str, ...] = ()  # for people, a sentence each: what is taken as absent

    @property
    def notes(self) -> tuple[str, ...]:
        """What is to be said of it, a sentence each."""
        return (*self.absences, *([self.better] if self.better else []))


def decision_of(
    config: DiagnosisConfig, paths: Sequence[Path], is_stopped: Callable[[], bool] = never
) -> tuple[DiagnosisConfig, LogDecision]:
    """Return how the logs of one drive are read, and the configuration that goes with it.

    Parameters
    ----------
    config
        What the user named; of a table without a profile the one that is proposed for it is taken.
    paths
        Logs of one drive; what comes through a pipe is read once, so nothing of it is taken as absent.
    is_stopped
        Ends the reading early: what was read until then decides.

    Raises
    ------
    SourceError, DefinitionError, ConfigError
        If a log or the database cannot be read, or no profile fits.
    StoppedError
        If it was stopped before a profile was proposed.
    """
    config = as_proposed(config, paths, is_stopped)
    return config, decide_log(config.interpretation(), config.calibration, paths, is_stopped, columns=config.columns)


def decide_log(
    meaning: Interpretation,
    calibration: Calibration,
    paths: Sequence[Path],
    is_stopped: Callable[[], bool] = never,
    *,
    columns: str = "",
) -> LogDecision:
    """Return how the logs of one drive are read with an interpretation at hand; see `decision_of`."""
    look = look_at(meaning, paths, is_stopped, columns=columns)
    decision = decide(meaning, calibration, look)
    gears = meaning.profile.gears
    over = next((speed for speed in BEHIND if speed in decision.alive), None)
    is_needed = not {Signal.CURRENT_GEAR, Signal.TARGET_GEAR} <= decision.alive and not decision.has_converter
    if gears is None and decision.still and is_needed and over is not None and Signal.ENGINE_SPEED in decision.alive:
        survey = VehicleSurvey(over)
        for batch in _read(decision.meaning.decoder(), paths, is_stopped, columns):
            survey.add(batch)
        gears = survey.learned().ratios
    return decision if gears is meaning.profile.gears else decide(meaning.with_gears(gears), calibration, look)


def decide(meaning: Interpretation, calibration: Calibration, look: LogLook) -> LogDecision:
    """Return how a drive is read after a look at it; pure.

    Parameters
    ----------
    meaning
        Database and profile that the user named, or that fit each other.
    calibration
        It says whether this is about a lock-up clutch, and where the engine's torque comes from.
    look
        What the first reading of the drive found.
    """
    has_converter, torque = calibration.converter is not None, calibration.torque
    received = look.received
    before = _tier(meaning.profile, received, torque, has_converter=has_converter)
    better = ""
    if not look.is_of_columns and look.heard_ids:
        better = better_profile(meaning, before, look.heard_ids)
    still = tuple(
        found
        for found in look.liveness.still(LEAST_RECORDED)
        # What another profile would find is no fault of the vehicle; what is optional need not come.
        if found.value is not None or not (better or meaning.profile.sources[found.signal].optional)
    )
    absent = {found.signal for found in still}
    sources = {signal: source for signal, source in meaning.profile.sources.items() if signal not in absent}
    alive = received - absent
    if Signal.ENGINE_SPEED in absent and alive >= SUMMED_SIGNALS:
        alive |= {Signal.ENGINE_SPEED}
    asked = _asked(meaning.profile, alive, has_converter=has_converter)
    known = _known(alive, torque)
    places = {signal: source.place for signal, source in meaning.profile.sources.items()}
    return LogDecision(
        meaning=replace(meaning, profile=replace(meaning.profile, sources=sources)) if absent else meaning,
        named=look.liveness.signals,
        alive=alive,
        still=still,
        tier=tier_of(known, **asked),
        missing=missing_for_next(known, **asked),
        has_converter=has_converter,
        better=better,
        is_of_whole=look.is_of_whole,
        absences=tuple(found.text(places.get(found.signal, "")) for found in still),
    )


def _known(signals: frozenset[Signal], torque: TorqueSource) -> frozenset[Signal]:
    return signals - {Signal.ENGINE_TORQUE} if torque is TorqueSource.UNKNOWN else signals


def _asked(profile: Profile, signals: AbstractSet[Signal], *, has_converter: bool) -> dict[str, bool]:
    """Return what tiers ask besides signals."""
    knows_gears = profile.gears is not None and signals >= {Signal.ENGINE_SPEED, profile.gears.over}
    return {"knows_gears": knows_gears, "has_converter": has_converter}


def _tier(profile: Profile, signals: frozenset[Signal], torque: TorqueSource, *, has_converter: bool) -> Tier | None:
    return tier_of(_known(signals, torque), **_asked(profile, signals, has_converter=has_converter))


def look_at(
    meaning: Interpretation, paths: Sequence[Path], is_stopped: Callable[[], bool] = never, *, columns: str = ""
) -> LogLook:
    """Return what a first reading of a drive finds; nothing is found of what comes through a pipe."""
    decoder = meaning.decoder()
    liveness, heard = Liveness.of(decoder.signals), set[int]()
    if not all(map(is_plain_file, paths)):  # standard input is none either
        return LogLook(liveness=liveness, received=decoder.signals, is_of_whole=False)
    for batch in _read(decoder, paths, is_stopped, columns, heard):
        liveness = liveness.advanced(batch)
        if liveness.is_settled:
            break
    is_of_columns = not meaning.profile.is_j1939 and meaning.profile.is_of_columns
    return LogLook(
        liveness=liveness,
        heard_ids=frozenset(heard),
        received=decoder.signals if liveness.is_settled else decoder.seen,
        is_of_columns=is_of_columns,
    )


def _read(
    decoder: Decoder,
    paths: Sequence[Path],
    is_stopped: Callable[[], bool],
    columns: str,
    heard: set[int] | None = None,
) -> Iterator[ColumnBatch]:
    """Yield the columns of a drive until it is stopped; ``heard`` takes up the identifiers of its frames."""
    with open_drive(paths, is_stopped=is_stopped, columns=columns) as logs:
        try:
            for batch in DriveFrames(logs, decoder.sources):
                if heard is not None:
                    heard.update(np.unique(batch.can_id).tolist())
                yield from decoder.stream(batch)
                if is_stopped():
                    return
        except InputLeftError:
            return
        yield from decoder.drain()


def better_profile(meaning: Interpretation, tier: Tier | None, heard_ids: AbstractSet[int]) -> str:
    """Return a sentence: which shipped profile gets a better tier out of these identifiers; empty if none does.

    Profiles are held against the database at hand, and against the one that ships with them.
    """
    fits = list[tuple[Tier, int, str]]()
    for name in shipped_profiles():
        fit = _heard(load_shipped(name), meaning.database, heard_ids)
        if name != meaning.profile.name and fit is not None and (tier is None or fit[0] < tier):
            fits.append((fit[0], -fit[1], name))
    if not fits:
        return ""
    reached, _, name = min(fits)
    options = f"--profile {name}"
    if is_of_lockup(load_shipped(name).sources.keys()):
        options += " --calibration lockup"
    elif is_of_lockup(meaning.profile.sources.keys()):
        options += ", without a calibration of a lock-up clutch"
    return f"this log holds the messages of profile {name}, which reaches tier {reached:d}: {options}"


def _heard(profile: Profile, database: Database, heard_ids: AbstractSet[int]) -> tuple[Tier, int] | None:
    """Return the tier that the signals of a profile suffice for which were heard, and how many; None if for none."""
    ids, tells = np.array(sorted(heard_ids), np.uint32), list[tuple[Tier, int]]()
    has_converter = is_of_lockup(profile.sources.keys())
    for known in [open_database(profile.database)] if profile.database else [database, open_database(None)]:
        mapped, _ = fitting(known, profile)
        slots = set(find_slots(address_book([message.address for message in mapped]), ids).tolist()) - {NOBODY}
        signals = frozenset(column.signal for slot in slots for column in mapped[slot].columns)
        tier = tier_of(signals, knows_gears=profile.gears is not None, has_converter=has_converter)
        tells += [] if tier is None else [(tier, len(signals))]
    return min(tells, key=lambda fit: (fit[0], -fit[1]), default=None)
