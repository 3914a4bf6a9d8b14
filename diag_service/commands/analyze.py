"""``diag-service analyze``: diagnose the logs of one drive, or folders of drives."""

import logging
import sys
from dataclasses import dataclass
from pathlib import Path

from canlog.errors import NOTICE
from canlog.logs import STANDARD_INPUT
from clutchdiag_io.program import replacement_refusal
from diag_service.api.choices import diagnosis_config
from diag_service.console import ReadingLine, collected_notices
from diag_service.delivery import AllReporters, MemoryReporter
from diag_service.diagnosis.summary import Gap
from diag_service.errors import ConfigError
from diag_service.service.application import reporter_of
from diag_service.service.drive import insist
from diag_service.service.drive_survey import DriveSurvey
from diag_service.service.recorded import run_recorded
from diag_service.service.stopping import Controls
from diag_service.settings.config import DeliveryOptions, DiagnosisConfig
from diag_service.settings.proposed import as_proposed

_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class AnalyzeOptions(DeliveryOptions):
    """What is analysed, and how."""

    logs: tuple[Path | str, ...]  # a text is the address of a store
    estimator: str = "impulse"
    output: Path | None = None
    force: bool = False
    jobs: int | None = None
    vehicle_from: str | None = None
    lake: Path | str | None = None
    scheduler: str = "local"
    signals: str | None = None
    time_limit: float
    retry: bool = False
    json: bool = False
    given: frozenset[str] = frozenset()  # what the command line itself says, not a settings file

    @property
    def paths(self) -> list[Path]:
        """The logs that are files or folders of this machine."""
        return [log for log in self.logs if isinstance(log, Path)]


def analyze(options: AnalyzeOptions, controls: Controls) -> None:
    if options.lake is not None:
        from diag_service.commands.lake import fill  # noqa: PLC0415 - nothing else needs any of it

        fill(options, controls)
        return
    _check_words_without_lake(options)
    if any(path.is_dir() for path in options.paths if path != STANDARD_INPUT):
        _analyse_folders(options, controls)
        return
    diagnosis = diagnosis_config(options)
    _check_words_for_a_drive(options)
    diagnosis = as_proposed(diagnosis, options.paths, lambda: controls.stop.is_set)
    if options.estimator != "paper":
        _analyse_drive(options, diagnosis, controls)
        return
    if options.store is not None or diagnosis.broker is not None or options.output is not None:
        raise ConfigError("the paper's method states no uncertainty: its results are shown, not stored or published")
    from diag_service.service import paper_run  # noqa: PLC0415 - the other method needs none of it

    paper_run.show_paper(diagnosis, options.paths, controls, as_json=options.json)


def _check_words_without_lake(options: AnalyzeOptions) -> None:
    if stored := [log for log in options.logs if isinstance(log, str)]:
        raise ConfigError(f"{stored[0]}: what is in a store is analysed into a lake: --lake PLACE")
    if options.scheduler != "local":
        raise ConfigError("--scheduler is for a lake: --lake PLACE says where the results go")
    if given := sorted({"signals", "time_limit", "retry"} & options.given):
        raise ConfigError(f"--{given[0].replace('_', '-')} is for a lake: --lake PLACE")


def _check_words_for_a_drive(options: AnalyzeOptions) -> None:
    if options.vehicle_from is not None:
        raise ConfigError("--vehicle-from is for folders: the logs that were named are one drive of one vehicle")
    if options.jobs is not None and options.output is None:
        raise ConfigError("--jobs is for folders: the logs that were named are one drive")
    if options.jobs is not None and options.jobs < 1:
        raise ConfigError(f"--jobs must be at least 1, got {options.jobs}")


def _analyse_drive(options: AnalyzeOptions, diagnosis: DiagnosisConfig, controls: Controls) -> None:
    """Show the results of a drive, and write them into a file if one is wanted: it is checked before hours of work."""
    if options.output is not None:
        from diag_service.batch.tables import check_output  # noqa: PLC0415 - for an output alone

        if text := replacement_refusal(options.output, is_forced=options.force):
            raise ConfigError(text)
        check_output(options.output)
    heard = MemoryReporter()
    with ReadingLine() as line, collected_notices() as notices:
        shown = reporter_of(controls.stop, as_json=options.json, is_detailed=controls.verbosity > 0)
        reporter = AllReporters(line, shown, *([] if options.output is None else [heard]))
        run = run_recorded(
            diagnosis, options.paths, options.store, reporter, controls.stop, survey=DriveSurvey, watch=line.watch
        )
    if options.output is not None and Gap.STOPPED not in run.summary.gaps:
        from diag_service.batch.tables import write_results  # noqa: PLC0415 - for an output alone
        from diag_service.batch.worker import drive_entry  # noqa: PLC0415 - likewise

        write_results(options.output, [drive_entry("", options.paths, run, heard.results, notices)])
        _LOG.log(NOTICE, "%d shifts of 1 drives in %s", len(heard.results), options.output)
    insist(run.summary.gaps, run.summary.contributions, is_strict=diagnosis.is_strict)


def _analyse_folders(options: AnalyzeOptions, controls: Controls) -> None:
    # What is on the command line: settings of other runs do not matter to folders.
    if "store" in options.given or options.estimator == "paper":
        raise ConfigError(
            "folders take neither --store nor --estimator paper: every drive in them is judged for itself, and a store "
            "keeps the state of one vehicle"
        )
    if STANDARD_INPUT in options.logs:
        raise ConfigError("folders are read by several processes: standard input does not go with them")
    if options.vehicle_from is not None and "vehicle" in options.given:
        raise ConfigError(
            "--vehicle-from takes the vehicles from the folders, --vehicle names one: use only one of them"
        )
    from diag_service.batch import folder_run  # noqa: PLC0415 - one drive needs none of it

    folder_run.analyse_folders(
        diagnosis_config(options),
        options.paths,
        output=options.output,
        jobs=options.jobs,
        listener=folder_run.FolderLines(sys.stdout, as_json=options.json),
        stop=controls.stop,
        is_shown=True,
        is_forced=options.force,
        has_vehicles=options.vehicle_from is not None,
    )
