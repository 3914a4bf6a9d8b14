"""``diag-service calibrate``: one vehicle's own calibration from its logs."""

from types import SimpleNamespace

from diag_service.commands.meaning import diagnosis_config
from diag_service.service import application
from diag_service.service.stopping import Trigger


def execute(options: SimpleNamespace, stop: Trigger, counts_wanted: Trigger) -> None:
    """Calibrate a vehicle and write its file."""
    controls = application.Controls(stop=stop, counts_wanted=counts_wanted)
    application.run_calibrate(diagnosis_config(options), options.logs, options.output, controls, as_json=options.json)
