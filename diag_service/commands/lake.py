"""``diag-service lake`` and ``analyze --lake``: what is in a lake, what came into it, what was taken out."""

import logging
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Final

from canlog.errors import NOTICE, SourceError
from canlog.logs import STANDARD_INPUT
from clutch_results.records import dump
from diag_service.api.lakes import LOCAL, check_lake, fill_from_logs, forget_vehicle
from diag_service.errors import ConfigError, IncompleteError
from diag_service.lake.parts import DONE, LogRow
from diag_service.settings.options import AnalyzeOptions
from diag_service.stopping import Controls

FORGOTTEN_SCHEMA: Final = "clutchdiag/forgotten/v1"
SHOWN: Final = 5  # of what is wrong
_NOT_FOR_LAKES: Final = ("output", "store", "broker", "json", "force")
_LOG = logging.getLogger(__name__)


def forget(place: Path | str, vehicle: str, *, json: bool) -> None:
    gone = forget_vehicle(place, vehicle)
    if json:
        sys.stdout.write(dump({"schema": FORGOTTEN_SCHEMA, **asdict(gone)}) + "\n")
        return
    sys.stdout.writelines(f"removed {part}\n" for part in gone.parts)
    sys.stdout.write(
        f"{gone.vehicle}: {len(gone.parts)} parts ({gone.part_bytes} bytes), {gone.rows} logs of the manifest with "
        f"{gone.shifts} shifts removed; a second check found nothing left. The logs themselves were not touched\n"
    )


def check(place: Path | str, *, repair: bool) -> None:
    """Show what is in a lake; raises IncompleteError if manifest and parts disagree."""
    disagreement = check_lake(place, repair=repair)
    sys.stdout.write(disagreement.text + "\n")
    wrong = {
        "missing": disagreement.missing,
        "of no log": disagreement.unknown,
        "of a log that is there in two states": disagreement.twice,
    }
    for what, names in wrong.items():
        if names:
            sys.stdout.write(f"{len(names)} parts {what}: {', '.join(names[:SHOWN])}\n")
    if any(wrong.values()):
        raise IncompleteError(
            f"{disagreement.lake}: manifest and parts disagree; --repair, and then another run into it, mend that"
        )


def fill(options: AnalyzeOptions, controls: Controls) -> None:
    """Bring a lake up to date; raises SourceError if no log could be analysed, now or before."""
    _check_words(options)
    address, totals = fill_from_logs(options, controls, _show_row)
    sys.stdout.write(
        f"{totals['logs']} logs: {totals['before']} in the lake before, {totals['done']} analysed with "
        f"{totals['shifts']} shifts, {totals['failed']} not\n"
    )
    if not totals["held"]:
        raise SourceError(f"none of {totals['logs']} logs could be analysed; --retry tries them again")
    _LOG.log(NOTICE, "the lake is %s", address)


def _show_row(row: LogRow) -> None:
    result = f"{row.shifts} shifts" if row.outcome == DONE else "not analysed"
    sys.stdout.write(f"{row.source}: {result}{f'; {row.reason}' if row.reason else ''}\n")
    sys.stdout.flush()


def _check_words(options: AnalyzeOptions) -> None:
    if given := [name for name in _NOT_FOR_LAKES if name in options.given]:
        raise ConfigError(f"--{given[0]} does not go with --lake: the results are in the lake")
    if options.estimator == "paper":
        raise ConfigError("the paper's method states no uncertainty: its results are shown, not kept")
    if STANDARD_INPUT in options.logs:
        raise ConfigError("a lake is made of what lies in folders and stores: standard input does not go with it")
    if options.scheduler == LOCAL and (options.ca or options.cert or options.key):
        raise ConfigError("--ca, --cert and --key are for a scheduler: --scheduler tls://HOST:PORT")
