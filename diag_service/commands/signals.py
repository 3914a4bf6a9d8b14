"""``diag-service signals``: what signals a log holds, and a profile proposed from them, as one TOML text."""

import sys
from types import SimpleNamespace

from diag_service.console import ReadingLine
from diag_service.mapping.survey import proposed_profile
from diag_service.service.stopping import Controls


def execute(options: SimpleNamespace, controls: Controls) -> None:
    """Survey a log and write a profile whose comments say what there is."""
    with ReadingLine() as line:
        text = proposed_profile(
            options.log,
            options.dbc,
            lambda: controls.stop.is_set,
            is_lenient=options.lenient,
            parser_time_s=options.parser_time,
            watch=line.watch,
            columns=options.columns or "",
        )
    sys.stdout.write(text)
