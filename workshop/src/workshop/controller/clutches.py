"""Adaptation and computed temperature of the clutches."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Final

from clutch_model.calibration import shipped_calibration
from clutch_model.pack import clutch_later_k, contact_torque_nm, film_law
from ecu_emulator.shift_control.touch_points import TouchPoint
from workshop.controller.memory import TestResult

CLUTCHES: Final = (1, 2)


@dataclass(frozen=True, slots=True, kw_only=True)
class Adaptation:
    """Adapted touch points by clutch; a clutch without one uses that of its type."""

    touch_points: Mapping[int, TouchPoint] = field(default_factory=dict)

    @property
    def is_done(self) -> bool:
        return set(self.touch_points) == set(CLUTCHES)

    def pressures_pa(self, nominal_pa: tuple[float, float]) -> tuple[float, float]:
        """Return the touch points in use [Pa]."""
        first, second = (
            point.pressure_pa if (point := self.touch_points.get(clutch)) is not None else nominal_pa[clutch - 1]
            for clutch in CLUTCHES
        )
        return first, second

    @property
    def stds_pa(self) -> dict[str, float]:
        """Standard deviations of the touch points, as values of the controller by source [Pa]."""
        return {
            f"clutch{clutch}_touch_std_pa": point.std_pa
            for clutch, point in self.touch_points.items()
            if math.isfinite(point.std_pa)
        }


ADAPTATION_CODE: Final = "P0810"
LIMIT_CODE: Final = "P2788"


def limit_test(adaptation: Adaptation | None) -> TestResult | None:
    """Return whether the adapted touch points are within their limits; None if there are none."""
    if adaptation is None or not adaptation.touch_points:
        return None
    is_at_limit = any(point.is_at_limit for point in adaptation.touch_points.values())
    return TestResult.FAILED if is_at_limit else TestResult.PASSED


def adaptation_test(adaptation: Adaptation | None, *, was_adapted: bool) -> TestResult:
    """Return the result of the test whether both clutches are adapted.

    Parameters
    ----------
    adaptation
        Adaptation of the controller; None: it was neither adapted nor cleared since its start.
    was_adapted
        Whether the touch points were known at its start.
    """
    is_adapted = was_adapted if adaptation is None else adaptation.is_done
    return TestResult.PASSED if is_adapted else TestResult.FAILED


ASSUMED_FRICTION: Final = 0.13  # docs/model.md (S1)
LEAST_SLIP_RAD_S: Final = 1.5  # below it a clutch may be locked, with less torque than its capacity


@dataclass(frozen=True, slots=True, kw_only=True)
class Pack:
    """One clutch of the type."""

    touch_pressure_pa: float
    torque_per_pressure_nm_pa: float
    heat_capacity_j_k: float
    convection_w_k: float


@cache
def packs_of(transmission: str = "nominal") -> tuple[Pack, ...]:
    """Return both clutches of a type of transmission."""
    packs = []
    for clutch in shipped_calibration(transmission).clutches:
        film = film_law(clutch)
        lining_nm_pa = float(contact_torque_nm(1.0, ASSUMED_FRICTION, 1.0, film.contact_factor_m3))
        packs.append(
            Pack(
                touch_pressure_pa=clutch.touch_pressure_pa,
                torque_per_pressure_nm_pa=lining_nm_pa * film.piston_area_m2 / film.lining_area_m2,
                heat_capacity_j_k=clutch.thermal.heat_capacity_j_k,
                convection_w_k=clutch.thermal.convection_w_k,
            )
        )
    return tuple(packs)


def heated_k(
    before_k: tuple[float, float] | None,
    known: Mapping[str, float],
    duration_s: float,
    packs: tuple[Pack, ...],
) -> tuple[float, float] | None:
    """Return the temperatures of both clutches [K], None while the oil's is not known.

    Parameters
    ----------
    before_k
        Temperatures before [K]; None: that of the oil.
    known
        Sensed values, in SI.
    duration_s
        Time since ``before_k`` [s], of any length: the balance is solved exactly for constant power.
    packs
        The clutches.
    """
    oil_k = known.get("sump_temperature_k")
    if oil_k is None:
        return before_k
    first, second = (
        clutch_later_k(
            was_k, oil_k, slip_power_w(known, clutch, pack), duration_s, pack.heat_capacity_j_k, pack.convection_w_k
        )
        for clutch, was_k, pack in zip(CLUTCHES, before_k or (oil_k, oil_k), packs, strict=True)
    )
    return first, second


def slip_power_w(known: Mapping[str, float], clutch: int, pack: Pack) -> float:
    """Return the friction power of a slipping clutch [W]; 0 without slip or pressure values."""
    slip_rad_s, pressure_pa = known.get(f"clutch{clutch}_slip_rad_s"), known.get(f"clutch{clutch}_pressure_pa")
    if slip_rad_s is None or pressure_pa is None or abs(slip_rad_s) < LEAST_SLIP_RAD_S:
        return 0.0
    touch_pa = known.get(f"clutch{clutch}_touch_pressure_pa", pack.touch_pressure_pa)
    return abs(slip_rad_s) * max(pressure_pa - touch_pa, 0.0) * pack.torque_per_pressure_nm_pa
