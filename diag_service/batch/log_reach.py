"""What single logs can tell: each is read once with every meaning that is known, and the best of them is named.

What counts is what came and lives, not what a profile names: of a signal that is mapped and never came nothing is told.
"""

import shlex
import tomllib
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial
from pathlib import Path
from typing import Final

import numpy as np

from canlog.database.addressing import LEAST_FIT, NOBODY, why_wrong
from canlog.decode.codec import Codec
from canlog.errors import DefinitionError, SourceError
from canlog.frames import FrameBatch
from canlog.logs import LogFormat, LogReader, read_log
from canlog.logs.log_counts import lost_texts
from canlog.traffic import MAX_IDS
from clutch_results.records import Tier
from clutchdiag_io.program import legible
from dbc.contract import DBC_PATH
from diag_service.console import collected_notices
from diag_service.diagnosis.capability import SignalNeed
from diag_service.diagnosis.columns import Signal
from diag_service.errors import ConfigError, StoppedError
from diag_service.mapping.interpretation import Interpretation, open_database, shipped_meanings
from diag_service.mapping.learning import proposed_profile
from diag_service.mapping.liveness import Liveness
from diag_service.mapping.mapped_messages import LOCKUP_PURPOSE, PURPOSE
from diag_service.mapping.profile import Profile, profile_of
from diag_service.service.log_decision import LogDecision, LogLook, decide, decide_log
from diag_service.service.needs import needs_of
from diag_service.service.stages import SignalReach
from diag_service.settings.config import PROPOSED, as_profiled, described_by
from diag_service.stopping import Trigger
from fleet_contract import JsonObject

REACH_SCHEMA: Final = "clutchdiag/reach/v1"
NO_LOG: Final = "no log"
UP_TO_A_SCALE: Final = "friction up to a scale"
FRAMES_OF_NOBODY: Final = "frames of a bus that no database here knows"
_NO_TIER: Final = len(Tier) + 1  # below the last one


@dataclass(frozen=True, slots=True, kw_only=True)
class LogReach:
    """What one file can tell of its vehicle, and what to do about it."""

    path: Path
    kind: str  # in words: format and meaning, or that it is no log
    vehicle: str | None = None  # as its folder says
    format: str | None = None
    database: Path | None = None  # of those that were named
    profile: str | None = None
    tier: Tier | None = None
    tells: str = ""
    missing: str = ""  # for the next better tier
    next_step: str = ""  # a command, or what a person does
    remarks: tuple[str, ...] = ()  # why it was not read, what is odd about it
    signals: tuple[str, ...] = ()  # that came and live
    absent: tuple[str, ...] = ()  # that the profile names besides

    @property
    def rank(self) -> int:
        """Where it stands among logs of a vehicle: the best is 1, what is no log is last."""
        return self.tier or _NO_TIER + (self.kind == NO_LOG)

    def to_record(self) -> JsonObject:
        """Return it as values of JSON, ``tier`` null where there is none."""
        names = ("vehicle", "kind", "format", "profile", "tier", "tells", "missing", "next_step")
        return {
            "schema": REACH_SCHEMA,
            "path": str(self.path),
            **{name: getattr(self, name) for name in names},
            "database": None if self.database is None else str(self.database),
            **{name: list(getattr(self, name)) for name in ("remarks", "signals", "absent")},
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class LogTask:
    """A file to be looked at, and the databases of the user that may be of its bus."""

    path: Path
    dbcs: tuple[Path, ...] = ()
    columns: str = ""
    vehicle: str | None = None

    @property
    def quoted(self) -> str:
        """Its path as a shell takes it."""
        return shlex.quote(str(self.path))


class TriedMeaning:
    """One meaning, tried on a log."""

    def __init__(self, meaning: Interpretation) -> None:
        self.meaning = meaning
        calibration, _ = described_by(None, meaning.profile)
        self.calibration = as_profiled(calibration, meaning.profile)
        self._decoder = meaning.decoder()
        self._liveness = Liveness.of(self._decoder.signals)

    def feed(self, batch: FrameBatch) -> None:
        """Take up what a batch says."""
        for columns in self._decoder.stream(batch):
            self._liveness = self._liveness.advanced(columns)

    def end(self) -> None:
        """Take up what was held back until the log ended."""
        for columns in self._decoder.drain():
            self._liveness = self._liveness.advanced(columns)

    @property
    def heard_count(self) -> int:
        """Of how many signals values came that can be believed."""
        return len(self._decoder.seen)

    @cached_property
    def decision(self) -> LogDecision:
        """How the log is read by this meaning, once it has ended; other profiles are tried by others."""
        look = LogLook(liveness=self._liveness, received=self._decoder.seen, is_of_columns=True)
        return decide(self.meaning, self.calibration, look)

    def look_again(self, task: "LogTask", is_stopped: Callable[[], bool]) -> None:
        """Look for the ratios of gears where signals stand still: where no gear lives they may tell it."""
        if self.decision.still:
            self.decision = decide_log(self.meaning, self.calibration, [task.path], is_stopped, columns=task.columns)

    @property
    def needs(self) -> tuple[SignalNeed, ...]:
        """What friction lacks, and by which profile each could be asked for."""
        alive, gears = self.decision.alive, self.meaning.profile.gears
        asked = SignalReach.of_signals(alive, gears, self.calibration).asked
        return needs_of(self._decoder, alive, self.calibration.torque, **asked)

    @property
    def rejected(self) -> str:
        """What of its frames was refused, in words; empty if none was."""
        counts = self._decoder.counts
        reasons = ", ".join(f"{count} {reason.replace('_', ' ')}" for reason, count in counts.rejected.items())
        return f"{sum(counts.rejected.values())} of {counts.on_bus} frames were refused ({reasons})" if reasons else ""

    @property
    def rank(self) -> tuple[int, int]:
        """The smaller the better: tier, then how many signals live."""
        return self.decision.tier or _NO_TIER, -len(self.decision.alive)


class TriedLog:
    """A log of frames, read once with every meaning that is known."""

    def __init__(self, dbcs: Sequence[Path]) -> None:
        self._trials = [TriedMeaning(meaning) for meaning in _meanings(tuple(dbcs))]
        self._ids: set[int] = set()
        self._dbcs = dbcs

    def read(self, reader: LogReader, is_stopped: Callable[[], bool]) -> None:
        """Read a log to its end; raises StoppedError, and SourceError if it cannot be read."""
        for batch in reader:
            if is_stopped():
                raise StoppedError("stopped early: nothing is said of a part of a log")
            if len(self._ids) < MAX_IDS:
                self._ids.update(np.unique(batch.can_id).tolist())
            for trial in self._trials:
                trial.feed(batch)
        for trial in self._trials:
            trial.end()

    def share_known(self, dbc: Path) -> float:
        """Return which share of the identifiers of the log a database of the user knows; 0 where that is chance."""
        codec = _codec(dbc)
        slots = codec.slots_of([*self._ids])
        known = slots[slots != NOBODY]
        if not len(known) or why_wrong(len(known), len(self._ids), len(np.unique(known)), len(codec.tables)):
            return 0.0
        return len(known) / len(self._ids)

    @property
    def right_dbc(self) -> Path | None:
        """The database of the user that knows most of the log; None if each may know some of it by chance."""
        best = max(self._dbcs, key=self.share_known, default=None)
        return best if best is not None and self.share_known(best) >= LEAST_FIT else None

    @property
    def ranked(self) -> list[TriedMeaning]:
        """The meanings that get anything out of the log, the best first."""
        return sorted(filter(self._is_possible, self._trials), key=lambda trial: trial.rank)

    def _is_possible(self, trial: TriedMeaning) -> bool:
        """Return whether a meaning gets anything out of the log that is hardly there by chance.

        A database of the user knows some of the bus, and a fifth of its identifiers where not even shifts are found.
        J1939 is known by its groups, of which a few serve.
        """
        dbc = next(iter(trial.meaning.files), None)
        if not trial.heard_count:
            return False
        if dbc is None or trial.meaning.profile.is_j1939:
            return True
        share = self.share_known(dbc)
        return share > 0.0 if trial.decision.tier else share >= LEAST_FIT

    @property
    def refused(self) -> str:
        """What was refused of frames of a bus that is known, in words; empty if nothing was."""
        return next((text for trial in self._trials if not trial.meaning.files and (text := trial.rejected)), "")


@cache  # in each process
def _meanings(dbcs: tuple[Path, ...]) -> tuple[Interpretation, ...]:
    return shipped_meanings(dbcs)


@cache
def _codec(dbc: Path) -> Codec:
    return Codec(open_database(dbc).messages)


def look_into(task: LogTask, stop: Trigger | None = None) -> LogReach:
    """Return what a file can tell; of one that cannot be read the reason.

    Raises StoppedError.
    """
    is_stopped = partial(getattr, stop or Trigger(), "is_set")
    with collected_notices():
        try:
            with closing(read_log(task.path, is_stopped=is_stopped, columns=task.columns)) as reader:
                if reader.columns:
                    return _of_table(task, reader.format.value, is_stopped)
                return _of_frames(task, reader, is_stopped)
        except (SourceError, ConfigError, DefinitionError) as exc:
            return unreadable(task, str(exc).removeprefix(f"{task.path}: "))


def _of_frames(task: LogTask, reader: LogReader, is_stopped: Callable[[], bool]) -> LogReach:
    trials = TriedLog(task.dbcs)
    trials.read(reader, is_stopped)
    losses, log_format = tuple(lost_texts(reader.counts)), reader.format.value
    ranked, dbc = trials.ranked, trials.right_dbc
    best = next(iter(ranked), None)
    if best is not None:
        best.look_again(task, is_stopped)
    if dbc is not None and (best is None or best.decision.tier is None):
        proposed = _proposed_trial(task, dbc, is_stopped)
        if best is None or proposed.rank < best.rank:
            best, ranked = proposed, []
    if best is None or not best.decision.alive:
        return LogReach(
            path=task.path, vehicle=task.vehicle, format=log_format, kind=f"{log_format}, {FRAMES_OF_NOBODY}",
            tells="nothing", missing="the database of its bus", remarks=(*losses, *filter(None, [trials.refused])),
            next_step=f"diag-service signals {task.quoted} --dbc FILE  # public ones of many cars: opendbc",
        )  # fmt: skip
    alike = [
        trial.meaning.profile.name
        for trial in ranked
        if trial is not best and trial.decision.alive == best.decision.alive
    ]
    same = (f"profile {' and '.join(dict.fromkeys(alike))} would read the same",) if alike else ()
    refused = (best.rejected,) if best.decision.tier is None and best.rejected else ()
    return _row(task, log_format, best, (*losses, *refused, *same))


def _of_table(task: LogTask, log_format: str, is_stopped: Callable[[], bool]) -> LogReach:
    trial = _proposed_trial(task, None, is_stopped)
    with closing(read_log(task.path, is_stopped=is_stopped, columns=task.columns)) as reader:
        counts = reader.counts
    return _row(task, log_format, trial, tuple(lost_texts(counts)))


def _proposed_trial(task: LogTask, dbc: Path | None, is_stopped: Callable[[], bool]) -> TriedMeaning:
    """Return the profile that ``signals`` proposes for a log, tried on it."""
    text = proposed_profile(task.path, dbc, is_stopped, columns=task.columns)
    profile = replace(profile_of(tomllib.loads(text), task.path), name=PROPOSED)
    logs = () if dbc is not None else (task.path,)
    database = open_database(dbc, logs, is_stopped=is_stopped, columns=task.columns)
    trial = TriedMeaning(Interpretation(database=database, profile=profile, files=() if dbc is None else (dbc,)))
    with closing(read_log(task.path, is_stopped=is_stopped, columns=task.columns)) as reader:
        for batch in reader:
            if is_stopped():
                raise StoppedError("stopped early: nothing is said of a part of a log")
            trial.feed(batch)
    trial.end()
    trial.look_again(task, is_stopped)
    return trial


def _row(task: LogTask, log_format: str, trial: TriedMeaning, remarks: Sequence[str]) -> LogReach:
    meaning, decision, dbc = trial.meaning, trial.decision, next(iter(trial.meaning.files), None)
    alive, tier = decision.alive, decision.tier
    reach = SignalReach.of_signals(alive, decision.meaning.profile.gears, trial.calibration)
    tells = (LOCKUP_PURPOSE if decision.has_converter else PURPOSE)[tier] if tier else ""
    if reach.is_relative:
        tells = f"{tells}, {UP_TO_A_SCALE}" if tells else UP_TO_A_SCALE
    return LogReach(
        path=task.path,
        vehicle=task.vehicle,
        kind=_kind(log_format, meaning, dbc),
        format=log_format,
        database=dbc,
        profile=meaning.profile.name,
        tier=tier,
        tells=tells or "nothing",
        missing=reach.missing if tier is Tier.FRICTION or reach.is_relative else decision.missing,
        next_step=_next_step(task, trial, reach, dbc),
        remarks=(*remarks, *(found.text(_place(meaning.profile, found.signal)) for found in decision.still)),
        signals=tuple(signal.value for signal in Signal if signal in alive),
        absent=tuple(signal.value for signal in Signal if signal in meaning.profile.sources.keys() - alive),
    )


def _place(profile: Profile, signal: Signal) -> str:
    source = profile.sources.get(signal)
    return "" if source is None else source.place


def _kind(log_format: str, meaning: Interpretation, dbc: Path | None) -> str:
    """Return what a file is and holds, in words."""
    profile = meaning.profile
    if profile.name == PROPOSED and dbc is None:
        return "table of signals" if log_format == LogFormat.SIGNALS else f"{log_format}, measured channels"
    if dbc is None and profile.is_of_columns:
        return f"{log_format}, answers of a controller, profile {profile.name}"
    database = dbc or profile.database or DBC_PATH
    how = "proposed profile" if profile.name == PROPOSED else f"profile {profile.name}"
    return f"{log_format}, frames of {database.name}, {how}"


def _next_step(task: LogTask, trial: TriedMeaning, reach: SignalReach, dbc: Path | None) -> str:
    """Return the command that a person uses next, and behind it what leads to the next better tier."""
    profile = trial.meaning.profile
    named = "" if dbc is None else f" --dbc {shlex.quote(str(dbc))}"
    is_proposed = profile.name == PROPOSED
    if reach.tier is None and profile.asked and reach.is_relative:
        return f"diag-service learn {task.quoted}{named} --profile {profile.name} -o car.toml  # finds gears"
    if reach.tier is None and not reach.is_relative:
        return f"diag-service signals {task.quoted}{named}  # lists all that it holds; a profile names what is what"
    if is_proposed and dbc is not None:
        return f"diag-service signals {task.quoted}{named} > car.toml  # check it, then analyze --profile car.toml"
    chosen = "" if is_proposed or (dbc is None and profile.name == "dct") else f" --profile {profile.name}"
    asking = next((need.profile for need in trial.needs if need.profile not in ("", profile.name)), None)
    asks = f"  # for friction: diag-service try --profile {asking} --active" if asking else ""
    return f"diag-service analyze {task.quoted}{named}{chosen}{asks}"


def unreadable(task: LogTask, reason: str) -> LogReach:
    """Return the row of a file of which nothing can be read."""
    return LogReach(path=task.path, kind=NO_LOG, vehicle=task.vehicle, remarks=(legible(reason),))
