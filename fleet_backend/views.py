"""The documented views as tables to select from; migrations create them, docs/fleet.md describes them."""

from typing import Final

from sqlalchemy import TableClause, column, table

from fleet_backend.schema import UtcDateTime

_FRICTION: Final = ("mu_c", "mu_s", "std_mu_c", "std_mu_s")
_MOMENTS: Final = frozenset(
    {
        "end_at",
        "produced_at",
        "connected_at",
        "metrics_at",
        "last_result_at",
        "last_at",
        "raised_at",
        "cleared_at",
        "acknowledged_at",
    }
)


def _view(name: str, *columns: str) -> TableClause:
    return table(name, *(column(text, UtcDateTime) if text in _MOMENTS else column(text) for text in columns))


FLEET: Final = _view(
    "fleet_worst_first",
    *("place", "vehicle", "clutch", "severity", "condition", "condition_reason", "advice"),
    *("level_ratio", "shift_count"),
    *_FRICTION,
    *("mu_c_low", "mu_c_high", "mu_s_low", "mu_s_high", "slope_s_rad", "slope_low_s_rad", "slope_high_s_rad"),
    *("probability_negative_slope", "odometer_m", "end_at", "fluid", "stream", "seq"),
    *("algorithm_version", "calibration_version"),
)

TREND: Final = _view(
    "clutch_trend",
    *("vehicle", "clutch", "shift_number", "odometer_m", "end_at"),
    *_FRICTION,
    *("random_std_mu_c", "random_std_mu_s", "covariance_mu_c_mu_s", "slope_s_rad", "std_slope_s_rad"),
    *("probability_negative_slope", "quality", "clutch_temperature_k"),
    *("running_mu_c", "running_std_mu_c", "running_mu_s", "running_std_mu_s"),
    *("running_slope_s_rad", "running_std_slope_s_rad", "running_probability_negative_slope"),
    *("condition", "level_ratio", "fluid", "stream", "seq", "algorithm_version", "calibration_version", "kind"),
)

CLUTCH_ALARM: Final = _view(
    "clutch_alarm",
    *("vehicle", "clutch", "alarm_number", "raised_at", "cleared_at", "shift_count", "reason", "stream", "seq"),
    *("acknowledged_at", "acknowledged_by", "note"),
)

IDENTITY_ALARM: Final = _view("identity_alarm", "vehicle", "raised_at", "last_at", "message_count", "reason")

LAST_SEEN: Final = _view(
    "last_seen", "vehicle", "is_online", "connected_at", "service_version", "metrics_at", "last_result_at"
)

CURRENT_SHIFT: Final = _view("current_shift", "vehicle", "stream", "seq")
