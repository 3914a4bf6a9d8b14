"""Tables of signals of which nobody says what their columns mean: they are read as is proposed for them."""

import logging
import tomllib
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

from canlog.errors import NOTICE
from canlog.logs import STANDARD_INPUT, table_columns
from canlog.logs.streams import never
from clutch_model.calibration import nominal_calibration
from clutchdiag_io.program import legible
from diag_service.mapping.interpretation import Interpretation, interpret
from diag_service.mapping.learning import proposed_profile
from diag_service.mapping.mapped_messages import reach_in_words
from diag_service.mapping.profile import Profile, profile_of
from diag_service.settings.config import DiagnosisConfig, as_profiled, described_by

PROPOSED: Final = "proposed"  # what such a profile is called
_LOG = logging.getLogger(__name__)


def as_proposed(
    config: DiagnosisConfig, logs: Sequence[Path], is_stopped: Callable[[], bool] = never
) -> DiagnosisConfig:
    """Return a configuration for some logs: the same, or with the profile proposed for the table that they are.

    Raises SourceError if a log cannot be read, StoppedError.
    """
    proposed = _proposed(logs, config.dbc, config.profile, is_stopped, config.columns)
    if proposed is None:
        return config
    calibration = config.calibration
    if calibration == nominal_calibration():  # nobody named another one
        calibration, _ = described_by(None, proposed)
    return replace(config, profile=proposed, calibration=as_profiled(calibration, proposed))


def _proposed(
    logs: Sequence[Path], dbc: Path | None, profile: Path | Profile | None, is_stopped: Callable[[], bool], columns: str
) -> Profile | None:
    """Return the profile proposed for the first of some logs, and tell of it; None if it is no table, or explained.

    What comes through a pipe is read once, so nothing is proposed for it.
    """
    if dbc is not None or profile is not None:
        return None
    log = next(iter(logs), STANDARD_INPUT)
    if log == STANDARD_INPUT or log.is_dir() or not table_columns(log, is_stopped=is_stopped, columns=columns):
        return None
    text = proposed_profile(log, is_stopped=is_stopped, columns=columns)
    proposed = replace(profile_of(tomllib.loads(text), log), name=PROPOSED)
    _LOG.log(
        NOTICE,
        "%s is a table of signals, read with the profile proposed for it, which reaches %s; 'diag-service signals' "
        "writes that profile, for you to check and name with --profile",
        legible(log.name),
        reach_in_words(proposed.sources.keys(), knows_gears=proposed.gears is not None),
    )
    return proposed


def interpret_logs(
    logs: Sequence[Path],
    dbc: Path | None,
    profile: Path | Profile | None,
    *,
    is_stopped: Callable[[], bool] = never,
    columns: str = "",
) -> Interpretation:
    """Return what `interpret` does; where the user named neither file, tables of signals are read as is proposed.

    Raises what `as_proposed` and `interpret` raise.
    """
    named = profile or _proposed(logs, dbc, profile, is_stopped, columns)
    return interpret(dbc, named)
