"""``diag-service analyze``: diagnose the logs of one drive, or folders of drives."""

from types import SimpleNamespace

from diag_service.commands.meaning import diagnosis_config
from diag_service.errors import ConfigError
from diag_service.service import application
from diag_service.service.stopping import Trigger
from diag_service.settings import config


def execute(options: SimpleNamespace, stop: Trigger, counts_wanted: Trigger) -> None:
    """Diagnose what was named."""
    is_stored = "store" in options.given  # on the command line: settings of other runs do not matter to folders
    diagnosis = diagnosis_config(options)
    controls = application.Controls(stop=stop, counts_wanted=counts_wanted)
    is_paper = options.estimator == config.EstimatorKind.PAPER
    if options.output is not None or any(path.is_dir() for path in options.logs):
        if is_paper or is_stored:
            raise ConfigError(
                "folders and --output take neither --store nor --estimator paper: every drive in them is judged for "
                "itself, and a store keeps the state of one vehicle"
            )
        from diag_service.batch import folder_run  # noqa: PLC0415 - one drive needs none of it

        folder_run.analyse_folders(
            diagnosis, options.logs, output=options.output, jobs=options.jobs, as_json=options.json, stop=stop
        )
        return
    if options.jobs is not None:
        raise ConfigError("--jobs is for folders: the logs that were named are one drive")
    if is_paper:
        config.check_paper_options(options.store, diagnosis.broker)
        application.run_paper_recorded(diagnosis, options.logs, controls, as_json=options.json)
        return
    application.run_recorded(diagnosis, options.logs, options.store, controls, as_json=options.json)
