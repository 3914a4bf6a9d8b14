"""What frames mean: database and profile, as the user named them or as they fit each other."""

import logging
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

from cantools.database.can import Database

from canlog.database.loading import bus_of, load_database
from canlog.database.signal_columns import columns_database
from canlog.errors import NOTICE
from canlog.files import is_folder
from canlog.logs import STANDARD_INPUT, table_columns
from canlog.logs.streams import never
from clutch_results.records import Tier
from dbc.contract import DBC_PATH, load_contract
from diag_service.diagnosis.columns import GearRatios, Signal
from diag_service.errors import ConfigError
from diag_service.mapping.decoder import Decoder
from diag_service.mapping.mapped_messages import fitting, is_of_lockup, missing_for_next, tier_of
from diag_service.mapping.profile import (
    PROFILE_FOLDER,
    Profile,
    find_profile,
    load_profile,
    load_shipped,
    shipped_profiles,
)


def open_database(
    path: Path | None,
    logs: Iterable[Path] = (),
    *,
    is_j1939: bool = False,
    is_stopped: Callable[[], bool] = never,
    columns: str = "",
) -> Database:
    """Return the database of a file, as `load_database` does; without one that of logs which are tables of signals.

    If there are none either, the shipped one, which needs no care.

    Raises DefinitionError, and SourceError if one of the logs cannot be read.
    """
    tables = () if path is not None else [log for log in logs if log == STANDARD_INPUT or not is_folder(log)]
    if named := [column for log in tables for column in table_columns(log, is_stopped=is_stopped, columns=columns)]:
        return columns_database(named)
    if path is None or path == DBC_PATH:
        return load_contract()
    return load_database(path, is_j1939=is_j1939)


MAX_COMPLAINTS = 3  # of a profile that does not fit: enough to see how far off it is
_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class Interpretation:
    """A database, the profile that reads it, and the files of the user that they came from."""

    database: Database
    profile: Profile
    files: tuple[Path, ...]  # with them the same log is another stream; none for what is built in

    def decoder(self) -> Decoder:
        return Decoder(self.database, self.profile)

    def with_gears(self, gears: GearRatios | None, *files: Path) -> Self:
        """Return the same with the ratios of a description, if it has some, and its file."""
        if gears is None:
            return self
        return replace(self, profile=replace(self.profile, gears=gears), files=(*self.files, *files))


def interpret(dbc: Path | None, profile: Path | Profile | None) -> Interpretation:
    """Return what the user named, checked; without a profile the shipped one that fits the database is taken and told.

    Raises ConfigError if a file cannot be used, or no profile fits.
    """
    if dbc is None and profile is None:
        return Interpretation(database=open_database(None), profile=load_profile(), files=())
    if profile is None:
        database = open_database(dbc)
        fit = choose_profile(database)
        _LOG.log(NOTICE, "%s", fit.text)
        return Interpretation(database=database, profile=fit.profile, files=_files(dbc, fit.profile, None))
    named = find_profile(profile)
    if named.is_of_columns and dbc is None:
        database = columns_database(named.columns)
        return Interpretation(database=database, profile=named, files=_files(None, named, profile))
    database = with_asked(open_database(dbc or named.database), named)
    if named.is_lenient:
        fit = fit_of(database, named)
        if fit.tier is None and not named.is_of_columns:  # what is asked for may need a vehicle file's gears
            raise ConfigError(f"profile {named.name} does not fit the database: {'; '.join(fit.problems)}")
        _LOG.log(NOTICE, "%s", fit.text)
    return Interpretation(database=database, profile=named, files=_files(dbc, named, profile))


def with_asked(database: Database, profile: Profile) -> Database:
    """Return a database with what a profile asks for as messages of its own."""
    if not profile.asked:
        return database
    names = {field.name for field in profile.asked.values()}
    asked = columns_database(column for column in profile.columns if column.name in names).messages
    return Database(messages=[*database.messages, *asked], dbc_specifics=database.dbc, strict=False)


def shipped_meanings(dbcs: Iterable[Path]) -> tuple[Interpretation, ...]:
    """Return every shipped profile with each database that it can read: its own one first, then those of the user.

    A profile that finds no shifts in a database is left out, unless what it needs is asked for. Raises DefinitionError
    if a database cannot be read.
    """
    databases = {dbc: open_database(dbc) for dbc in dict.fromkeys(dbcs)}
    meanings, known = list[Interpretation](), list[tuple[Path | None, Database]]()
    for profile in map(load_shipped, shipped_profiles()):
        if profile.is_of_columns:  # what it needs is asked for
            meanings.append(Interpretation(database=columns_database(profile.columns), profile=profile, files=()))
            known = [*databases.items()]
        else:
            known = [(None, open_database(profile.database)), *databases.items()]
        meanings += [
            Interpretation(database=with_asked(database, profile), profile=profile, files=() if dbc is None else (dbc,))
            for dbc, database in known
            if fit_of(database, profile).tier is not None
        ]
    return tuple(meanings)


def _files(dbc: Path | None, profile: Profile, named: Path | Profile | None) -> tuple[Path, ...]:
    shipped = PROFILE_FOLDER / f"{profile.name}.toml"
    source = shipped if profile.is_lenient else named if isinstance(named, Path) else None
    return tuple(bus_of(path)[0] for path in (dbc, source) if path is not None)


@dataclass(frozen=True, slots=True, kw_only=True)
class ProfileFit:
    """How well a profile fits a database."""

    profile: Profile
    tier: Tier | None
    signals: frozenset[Signal]
    problems: tuple[str, ...]

    @property
    def text(self) -> str:
        """The fit in words, with what the next better tier would need."""
        text = f"profile {self.profile.name}: {len(self.signals)} of {len(self.profile.sources)} signals"
        missing = missing_for_next(self.signals, **_tells(self.profile))
        return f"{text}, tier {self.tier or 'none'}{f'; {missing}' if missing else ''}"


def _tells(profile: Profile) -> dict[str, bool]:
    """Return what tiers ask of a profile besides its signals."""
    return {"knows_gears": profile.gears is not None, "has_converter": is_of_lockup(profile.sources.keys())}


def fit_of(database: Database, profile: Profile) -> ProfileFit:
    mapped, problems = fitting(database, profile)
    signals = frozenset(column.signal for message in mapped for column in message.columns)
    tier = tier_of(signals, **_tells(profile))
    return ProfileFit(profile=profile, tier=tier, signals=signals, problems=problems)


def choose_profile(database: Database) -> ProfileFit:
    """Return the shipped profile that gets most out of a database.

    Raises ConfigError if not even shifts can be found with any of them; the text says what is missing.
    """
    fits = [fit_of(database, load_shipped(name)) for name in shipped_profiles()]
    usable = [fit for fit in fits if fit.tier is not None]
    if not usable:
        reasons = "; ".join(f"{fit.profile.name}: {_first_of(fit.problems)}" for fit in fits)
        raise ConfigError(
            f"no shipped profile fits the database; 'diag-service signals' proposes one for --profile. {reasons}"
        )
    return min(usable, key=lambda fit: (fit.tier or Tier.KINEMATIC, -len(fit.signals) / len(fit.profile.sources)))


def _first_of(problems: tuple[str, ...]) -> str:
    more = len(problems) - MAX_COMPLAINTS
    return ", ".join([*problems[:MAX_COMPLAINTS], *([f"and {more} more"] if more > 0 else [])])
