"""``diag-service analyze``: diagnose the logs of one drive, or folders of drives."""

import sys
from types import SimpleNamespace

from diag_service.errors import ConfigError
from diag_service.service import application, paper_run
from diag_service.service.drive import insist
from diag_service.service.stopping import Controls
from diag_service.settings.config import diagnosis_config


def execute(options: SimpleNamespace, controls: Controls) -> None:
    """Diagnose what was named."""
    is_stored = "store" in options.given  # on the command line: settings of other runs do not matter to folders
    diagnosis = diagnosis_config(options)
    is_paper = options.estimator == "paper"
    if options.output is not None or any(path.is_dir() for path in options.logs):
        if is_paper or is_stored:
            raise ConfigError(
                "folders and --output take neither --store nor --estimator paper: every drive in them is judged for "
                "itself, and a store keeps the state of one vehicle"
            )
        from diag_service.batch import folder_run  # noqa: PLC0415 - one drive needs none of it

        lines = folder_run.FolderLines(sys.stdout, as_json=options.json)
        folder_run.analyse_folders(
            diagnosis,
            options.logs,
            output=options.output,
            jobs=options.jobs,
            listener=lines,
            stop=controls.stop,
            is_shown=True,
        )
        return
    if options.jobs is not None:
        raise ConfigError("--jobs is for folders: the logs that were named are one drive")
    if is_paper:
        if options.store is not None or diagnosis.broker is not None:
            raise ConfigError(
                "the paper's method states no uncertainty: its results are shown, not stored or published"
            )
        paper_run.show_paper(diagnosis, options.logs, controls, as_json=options.json)
        return
    reporter = application.reporter_of(controls.stop, as_json=options.json)
    summary = application.run_recorded(diagnosis, options.logs, options.store, reporter, controls.stop)
    insist(summary.gaps, summary.contributions, is_strict=diagnosis.is_strict)
