"""What the other commands do, from Python: signals of logs, what a log holds, a vehicle's own calibration."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Unpack

import canlog
from canlog.tables.decoding import EVERY_SIGNAL
from canlog.whole_log import Log
from clutch_model.calibration import nominal_calibration, read_calibration
from diag_service.api.choices import AnyPath, AnyPaths, LogMeaning, configuration, optional_path, path_list
from diag_service.commands.arguments import DEFAULT_BITRATE
from diag_service.commands.inspect import Inspection, inspect_log
from diag_service.commands.learn import learned_from, record, write_description
from diag_service.commands.predict import predict_shifts
from diag_service.console import collected_notices
from diag_service.diagnosis.friction.paper import PaperShift, PooledClutch
from diag_service.diagnosis.friction.self_calibration import SelfCalibration
from diag_service.mapping.databases import open_database
from diag_service.mapping.survey import proposed_profile
from diag_service.service.calibrate_run import calibrated, write_calibration
from diag_service.service.drive import insist
from diag_service.service.paper_run import run_paper
from diag_service.service.stopping import Trigger
from diag_service.settings.proposed import interpret_logs


def read(
    paths: AnyPaths,
    dbc: AnyPath | None = None,
    *,
    is_strict: bool = False,
    columns: str = "",
) -> Log:
    """Return the frames of logs and their signals as arrays or tables, as ``diag-service decode`` writes them.

    Parameters
    ----------
    paths
        One log, or several, whose frames are put in the order of time.
    dbc
        Message database; without one the shipped one.
    is_strict, columns
        As of ``analyze``.

    Returns
    -------
    canlog.Log
        ``.signals()`` for arrays by ``Message.Signal``, ``.to_pandas()``, ``.to_polars()``, ``.to_arrow()``;
        ``.losses`` says what of the log is not in them. Values are in the units of the database.

    Raises
    ------
    SourceError, DefinitionError
        If a log or the database cannot be read.
    """
    with collected_notices():
        database = open_database(optional_path(dbc), path_list(paths))
        return canlog.read(path_list(paths), database, is_strict=is_strict, columns=columns)


def decode(
    paths: AnyPaths,
    output: AnyPath,
    dbc: AnyPath | None = None,
    choice: canlog.TableChoice = EVERY_SIGNAL,
) -> list[str]:
    """Write the signals of logs as a table of any size, as ``diag-service decode`` does.

    Parameters
    ----------
    output
        The table, which appears when it is complete; one that is there is replaced.
    choice
        What is written, and how: every signal in a row per frame, unless it says otherwise.
    paths, dbc
        As of ``read``.

    Returns
    -------
    list of str
        What of the logs is not in the table though it should be, in words.

    Raises
    ------
    SourceError, DefinitionError, OutputError, ExtraMissingError
        If a log or the database cannot be read, the table cannot be written, or a library for it is missing.
    """
    with collected_notices():
        database = open_database(optional_path(dbc), path_list(paths))
        return canlog.write_table(path_list(paths), database, Path(output), choice)


def inspect(
    path: AnyPath,
    dbc: AnyPath | None = None,
    *,
    bitrate: int = DEFAULT_BITRATE,
    columns: str = "",
) -> Inspection:
    """Return what traffic a log holds, as ``diag-service inspect`` shows it.

    Parameters
    ----------
    bitrate
        That the bus load is told for [bit/s].
    path, dbc, columns
        As of ``analyze``.

    Raises
    ------
    SourceError, DefinitionError, ConfigError
        If the log or the database cannot be read, or the bit rate is not above zero.
    """
    with collected_notices():
        messages = open_database(optional_path(dbc), [Path(path)]).messages
        return inspect_log(Path(path), messages, bitrate, Trigger(), columns=columns)


def propose_profile(path: AnyPath, dbc: AnyPath | None = None, *, columns: str = "") -> str:
    """Return a profile for a vehicle as TOML text, proposed from a log and its database: ``diag-service signals``.

    Raises
    ------
    SourceError, DefinitionError
        If the log or the database cannot be read.
    """
    with collected_notices():
        return proposed_profile(Path(path), optional_path(dbc), columns=columns)


def predict(
    paths: AnyPaths,
    profile: AnyPath | None = None,
    dbc: AnyPath | None = None,
    *,
    touch_pa: float | None = None,
    is_by_halves: bool = False,
) -> list[dict[str, Any]]:
    """Predict shifts of logs from the others, as ``diag-service predict`` does (docs/logs.md).

    Parameters
    ----------
    paths
        Logs of one type of vehicle, frames or tables of signals.
    profile, dbc
        As of ``analyze``.
    touch_pa
        Touch point of the clutches [Pa]; None: the pressure in gear at standstill.
    is_by_halves
        Whether the second half is predicted from the first; else each shift from all others.

    Returns
    -------
    list of dict
        A record for each kind of gear change of which there are enough: ``shifts`` with the recorded change of engine
        speed [rad/s] and what each model said of it, and ``scores``.

    Raises
    ------
    SourceError, DefinitionError, ConfigError
        If a log or the database cannot be read, or the profile lacks what a prediction needs.
    """
    with collected_notices():
        logs = path_list(paths)
        meaning = interpret_logs(logs, optional_path(dbc), optional_path(profile))
        found = predict_shifts(logs, meaning, touch_pa=touch_pa, is_by_halves=is_by_halves, stop=Trigger())
    return found.records()


def learn(
    paths: AnyPaths,
    profile: AnyPath | None = None,
    dbc: AnyPath | None = None,
    *,
    output: AnyPath | None = None,
    calibration: AnyPath | None = None,
    columns: str = "",
) -> dict[str, Any]:
    """Describe an unknown vehicle from its logs, as ``diag-service learn`` does.

    Parameters
    ----------
    paths
        Logs of one vehicle, frames or tables of signals.
    profile, dbc, columns
        As of ``analyze``.
    output
        Where the description goes, which ``analyze(calibration=...)`` takes; None: nowhere.
    calibration
        Of the type that all is assumed from which the logs do not tell; None: the shipped one.

    Returns
    -------
    dict
        ``gears`` with ratio, deviation and clutch of each, and by clutch touch points [Pa], lags [s] and gains
        [rad/s^2 a Pa], each with its deviation and origin; what is absent the logs do not tell.

    Raises
    ------
    SourceError, DefinitionError, ConfigError
        If a log or the database cannot be read, or the profile lacks the speeds.
    """
    with collected_notices():
        logs = path_list(paths)
        meaning = interpret_logs(logs, optional_path(dbc), optional_path(profile), columns=columns)
        learned = learned_from(logs, meaning, stop=Trigger(), columns=columns)
        if output is not None:
            assumed = nominal_calibration() if calibration is None else read_calibration(Path(calibration))
            write_description(Path(output), learned, assumed, path_list(paths))
    return record(learned)


def calibrate(
    paths: AnyPaths,
    *,
    output: AnyPath | None = None,
    **meaning: Unpack[LogMeaning],
) -> SelfCalibration:
    """Find one vehicle's sensor errors and inertia from its logs, as ``diag-service calibrate`` does.

    Parameters
    ----------
    output
        TOML file to write.
    paths, vehicle, dbc, profile, calibration, columns
        As of ``analyze``; the logs may be of several drives of the one vehicle.

    Returns
    -------
    SelfCalibration
        ``.calibration`` is what ``analyze(calibration=...)`` takes; ``.std(name)`` is how sure each parameter is.

    Raises
    ------
    ConfigError, DefinitionError, CalibrationError
        If an argument cannot be used, the drives do not suffice, or the file cannot be written.
    SourceError
        If a log cannot be read, or there is no shift in them.
    """
    with collected_notices():
        found = calibrated(configuration(**meaning), path_list(paths), Trigger()).found
        if output is not None:
            write_calibration(Path(output), found.calibration)
        return found


@dataclass(frozen=True, slots=True, kw_only=True)
class PaperAnalysis:
    """What a drive says by the method of SAE 2015-01-1146, which states no uncertainty and gives no verdict."""

    shifts: tuple[PaperShift, ...]
    clutches: tuple[PooledClutch, ...]  # 1 and 2, all shifts together
    is_complete: bool  # whether the whole drive was seen
    notices: tuple[str, ...]


def analyze_by_paper(
    paths: AnyPaths,
    *,
    is_strict: bool = False,
    **meaning: Unpack[LogMeaning],
) -> PaperAnalysis:
    """Analyse the logs of one drive as ``diag-service analyze --estimator paper`` does; arguments as of ``analyze``.

    Raises what ``analyze`` raises.
    """
    shifts: list[PaperShift] = []
    with collected_notices() as notices:
        config = configuration(is_strict=is_strict, **meaning)
        run = run_paper(config, path_list(paths), Trigger(), shifts.append)
    if is_strict:
        insist(run.account.gaps, run.account.contributions, is_strict=True)
    return PaperAnalysis(
        shifts=tuple(shifts), clutches=run.clutches, is_complete=not run.account.gaps, notices=tuple(notices)
    )
