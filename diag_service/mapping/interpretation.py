"""What frames mean: database and profile, as the user named them or as they fit each other."""

import logging
from dataclasses import dataclass
from pathlib import Path

from cantools.database.can import Database

from canlog.database.loading import bus_of
from canlog.notice import NOTICE
from diag_service.errors import ConfigError
from diag_service.mapping.databases import open_database
from diag_service.mapping.decoder import Decoder
from diag_service.mapping.profile import PROFILE_FOLDER, Profile, find_profile, load_profile
from diag_service.mapping.profile_choice import choose_profile, fit_of

_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class Interpretation:
    """A database, the profile that reads it, and the files of the user that they came from."""

    database: Database
    profile: Profile
    files: tuple[Path, ...]  # with them the same log is another stream; none for what is built in

    def decoder(self) -> Decoder:
        """Return a fresh decoder."""
        return Decoder(self.database, self.profile)


def interpret(dbc: Path | None, profile: Path | None, *, is_lenient: bool = False) -> Interpretation:
    """Return what the user named, checked; without a profile the shipped one that fits the database is taken and told.

    Raises ConfigError if a file cannot be used, or no profile fits.
    """
    if dbc is None and profile is None:
        return Interpretation(database=open_database(None), profile=load_profile(), files=())
    if profile is None:
        database = open_database(dbc, is_lenient=is_lenient)
        fit = choose_profile(database)
        _LOG.log(NOTICE, "%s", fit.said)
        return Interpretation(database=database, profile=fit.profile, files=_files(dbc, fit.profile, None))
    named = find_profile(profile)
    database = open_database(dbc or named.database, is_lenient=is_lenient)
    if named.is_lenient:
        fit = fit_of(database, named)
        if fit.tier is None:
            raise ConfigError(f"profile {named.name} does not fit the database: {'; '.join(fit.problems)}")
        _LOG.log(NOTICE, "%s", fit.said)
    return Interpretation(database=database, profile=named, files=_files(dbc, named, profile))


def _files(dbc: Path | None, profile: Profile, named: Path | None) -> tuple[Path, ...]:
    shipped = PROFILE_FOLDER / f"{profile.name}.toml"
    source = shipped if profile.is_lenient else named
    return tuple(bus_of(path)[0] for path in (dbc, source) if path is not None)
