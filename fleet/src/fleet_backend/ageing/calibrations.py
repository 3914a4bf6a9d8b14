"""What vehicles say of their calibrations: the type that each describes, and the friction of its clutches when new.

A version holds a digest of its numbers, so what was read once of a vehicle and a version stays as it is.
"""

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any, Final

from sqlalchemy import Connection, select

from clutch_model.calibration import FrictionCurve, nominal_calibration
from clutch_model.errors import CalibrationError
from clutch_model.fingerprint import fingerprint
from clutch_results.records import from_plain
from fleet_backend.schema import CALIBRATION

_MOST_NAMES: Final = 500  # of vehicles in one statement


@dataclass(frozen=True, slots=True, kw_only=True)
class KnownCalibration:
    """A calibration as far as the fleet needs it."""

    vehicle_type: str
    new_friction: tuple[FrictionCurve, ...]  # of clutch 1 and 2


_KNOWN: Final[dict[tuple[str, str], KnownCalibration]] = {}  # by vehicle and version


@cache
def _shipped() -> tuple[str, KnownCalibration]:
    shipped = nominal_calibration()
    friction = tuple(clutch.friction for clutch in shipped.clutches)
    known = KnownCalibration(vehicle_type=shipped.name, new_friction=friction)
    return f"{shipped.version}+{fingerprint(shipped)}", known


def shipped_calibration() -> str:
    """Return the version of results that were made with the shipped calibration."""
    return _shipped()[0]


def remember(connection: Connection, versions: Iterable[tuple[str, str]]) -> None:
    """Read what vehicles told of these versions, unless it is known: pairs of a vehicle and a version."""
    unknown = sorted({vehicle for vehicle, version in versions if _known(vehicle, version) is None})
    for first in range(0, len(unknown), _MOST_NAMES):
        table = CALIBRATION.c
        statement = select(table.vehicle, table.calibration_version, table.content)
        for row in connection.execute(statement.where(table.vehicle.in_(unknown[first : first + _MOST_NAMES]))):
            if (calibration := _calibration(json.loads(row.content))) is not None:
                _KNOWN[row.vehicle, row.calibration_version] = calibration


def type_of(vehicle: str, version: str) -> str:
    """Return the vehicle type that a calibration describes: its name, or the version where nobody told it."""
    known = _known(vehicle, version)
    return version if known is None else known.vehicle_type


def reference_of(vehicle: str, version: str, clutch: int) -> FrictionCurve | None:
    """Return the friction of a clutch with new fluid; None for a calibration of which nobody told it."""
    known = _known(vehicle, version)
    return None if known is None or clutch > len(known.new_friction) else known.new_friction[clutch - 1]


def _known(vehicle: str, version: str) -> KnownCalibration | None:
    shipped_version, shipped = _shipped()
    return shipped if version == shipped_version else _KNOWN.get((vehicle, version))


def _calibration(record: Mapping[str, Any]) -> KnownCalibration | None:
    """Return the calibration in a vehicle's status; None where no clutch can be like that."""
    try:
        curves = tuple(from_plain(curve, FrictionCurve) for curve in record["new_friction"])
    except (CalibrationError, KeyError, TypeError, ValueError):  # a ValueError of what has no default
        return None
    return KnownCalibration(vehicle_type=record["vehicle_type"], new_friction=curves)
