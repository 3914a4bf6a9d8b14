"""The diagnostic service: reads frames, finds shifts, estimates friction, judges the fluid, stores and publishes.

    analysis = diag_service.analyze("drive.log")
    print(analysis.verdicts[1].condition.name, analysis.verdicts[1].reason)

What is named here is imported when it is first used, and prints nothing (docs/python.md).
"""

import typing

from canlog.extras import on_demand as _on_demand

if typing.TYPE_CHECKING:
    from canlog.errors import CanlogError, DefinitionError, ExtraMissingError, OutputError, SourceError
    from canlog.tables.decoding import TableChoice
    from clutch_model.errors import CalibrationError
    from clutch_results.records import ClutchVerdict, Condition, ShiftEstimate, ShiftResult, Status
    from diag_service.api.analysis import Analysis, PaperAnalysis, ResultTable, analyze, analyze_by_paper
    from diag_service.api.calibration import calibrate
    from diag_service.api.choices import Delivery, Poll
    from diag_service.api.expectations import expect_frames, expect_same_frames, expect_shifts, expect_verdict
    from diag_service.api.folders import FolderAnalysis, analyze_folders
    from diag_service.api.learning import learn, predict
    from diag_service.api.live import BackgroundDiagnosis, LiveDiagnosis, diagnose
    from diag_service.api.logs import decode, inspect, propose_profile, read
    from diag_service.api.reaches import survey_logs
    from diag_service.api.stores import history, note_fluid, stored_shift, write_report
    from diag_service.batch.log_reach import LogReach
    from diag_service.errors import (
        ConfigError,
        ControllerError,
        DiagServiceError,
        IncompleteError,
        PublishError,
        RefusedError,
        SilentError,
        StoreError,
    )
    from fleet_contract.errors import ResultError

__all__ = [
    "Analysis",
    "BackgroundDiagnosis",
    "CalibrationError",
    "CanlogError",
    "ClutchVerdict",
    "Condition",
    "ConfigError",
    "ControllerError",
    "DefinitionError",
    "Delivery",
    "DiagServiceError",
    "ExtraMissingError",
    "FolderAnalysis",
    "IncompleteError",
    "LiveDiagnosis",
    "LogReach",
    "OutputError",
    "PaperAnalysis",
    "Poll",
    "PublishError",
    "RefusedError",
    "ResultError",
    "ResultTable",
    "ShiftEstimate",
    "ShiftResult",
    "SilentError",
    "SourceError",
    "Status",
    "StoreError",
    "TableChoice",
    "analyze",
    "analyze_by_paper",
    "analyze_folders",
    "calibrate",
    "decode",
    "diagnose",
    "expect_frames",
    "expect_same_frames",
    "expect_shifts",
    "expect_verdict",
    "history",
    "inspect",
    "learn",
    "note_fluid",
    "predict",
    "propose_profile",
    "read",
    "stored_shift",
    "survey_logs",
    "write_report",
]

__getattr__, __dir__ = _on_demand(__name__, __file__)
