"""``diag-service calibrate``: one vehicle's own calibration from its logs."""

from types import SimpleNamespace

from clutchdiag_io.files import replacement_refusal
from diag_service.errors import ConfigError
from diag_service.service import calibrate_run
from diag_service.service.stopping import Controls
from diag_service.settings.config import diagnosis_config


def execute(options: SimpleNamespace, controls: Controls) -> None:
    """Calibrate a vehicle and write its file."""
    if text := replacement_refusal(options.output, is_forced=options.force):
        raise ConfigError(text)
    config = diagnosis_config(options)
    calibrate_run.run_calibrate(config, options.logs, options.output, controls.stop, as_json=options.json)
