"""What the controller thinks of its clutches: friction with its deviation, and whether the fluid is worn out."""

import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Final

from ecu_emulator.diagnostics.adaptation import CLUTCHES, Adaptation
from ecu_emulator.diagnostics.codes import Status
from ecu_emulator.diagnostics.memory import TestResult, TroubleRecord
from ecu_emulator.scenario.scenario import FluidVerdict, OnBoard

FLUID_CODE: Final = "P0897"
ADAPTATION_CODE: Final = "P0810"
LIMIT_CODE: Final = "P2788"
SUPPRESSING: Final = (  # while one has failed, friction is not judged
    "P0711", "P0715", "P0716", "P0746", "P0747", "P0776", "P0777", "P0841", "P0846", "P0868",
)  # fmt: skip
SHIFT_SCHEMA: Final = "clutchdiag/shift/v1"
_QUANTITIES: Final = {"mu_c": "mu_c", "std_mu_c": "mu_c_std", "mu_s": "mu_s", "std_mu_s": "mu_s_std"}
_FLUID_NUMBERS: Final = {verdict: number for number, verdict in enumerate(FluidVerdict)}  # as routines tell it


@dataclass(frozen=True, slots=True, kw_only=True)
class OnBoardFriction:
    """What is thought of one clutch; friction that is not known is NaN."""

    fluid: FluidVerdict = FluidVerdict.NO_VERDICT
    mu_c: float = math.nan
    std_mu_c: float = math.nan
    mu_s: float = math.nan
    std_mu_s: float = math.nan
    end_ns: int = 0  # bus time of the end of the event that it comes from; 0: it comes from none


OnBoardEstimates = Mapping[int, OnBoardFriction]  # by clutch, 1 and 2


def scenario_friction(told: OnBoard) -> OnBoardFriction:
    """Return the estimate that a scenario gives the controller."""
    known = {name: getattr(told, name) for name in _QUANTITIES}
    return OnBoardFriction(fluid=told.fluid, **{name: value for name, value in known.items() if value is not None})


def values_of(estimates: OnBoardEstimates) -> dict[str, float]:
    """Return what is known, as values of the controller by source; a verdict is the number of its word."""
    found = {
        f"clutch{clutch}_{source}": float(getattr(estimate, name))
        for clutch, estimate in estimates.items()
        for name, source in _QUANTITIES.items()
    }
    verdicts = {
        f"clutch{clutch}_fluid": float(_FLUID_NUMBERS[estimate.fluid])
        for clutch, estimate in estimates.items()
        if estimate.fluid is not FluidVerdict.NO_VERDICT
    }
    return verdicts | {source: value for source, value in found.items() if math.isfinite(value)}


def fluid_test(estimates: OnBoardEstimates, failed: Iterable[str]) -> TestResult | None:
    """Return the result of the test of the fluid; None if nothing is known, or sensors cannot be believed.

    Parameters
    ----------
    failed
        The trouble codes whose test has failed.
    """
    words = {estimate.fluid for estimate in estimates.values()} - {FluidVerdict.NO_VERDICT}
    if not words or not set(SUPPRESSING).isdisjoint(failed):
        return None
    return TestResult.FAILED if FluidVerdict.CHANGE_FLUID in words else TestResult.PASSED


def limit_test(adaptation: Adaptation | None) -> TestResult | None:
    """Return the result of the test whether what is adapted is within its limits; None if nothing is."""
    if adaptation is None or not adaptation.touch_points:
        return None
    is_at_limit = any(point.is_at_limit for point in adaptation.touch_points.values())
    return TestResult.FAILED if is_at_limit else TestResult.PASSED


def adaptation_test(
    adaptation: Adaptation | None, estimates: OnBoardEstimates, *, was_adapted: bool
) -> TestResult | None:
    """Return the result of the test whether the clutches are known, None while that cannot be told.

    Parameters
    ----------
    adaptation
        What the controller has adapted or cleared itself; None: nothing, it works as at its start.
    estimates
        What is thought of the clutches.
    was_adapted
        Whether it knew the touch points at its start.
    """
    is_adapted = was_adapted if adaptation is None else adaptation.is_done
    if not is_adapted:
        return TestResult.FAILED
    known = (estimates.get(clutch, OnBoardFriction()).fluid for clutch in CLUTCHES)
    if FluidVerdict.NO_VERDICT not in known:
        return TestResult.PASSED
    return None if adaptation is None or adaptation.awaits_estimate else TestResult.PASSED


def failed_codes(records: Mapping[int, TroubleRecord], codes: Mapping[int, str]) -> set[str]:
    """Return the trouble codes whose test has failed, as scan tools show them."""
    return {codes[number] for number, record in records.items() if record.status & Status.TEST_FAILED}


def read_line(line: bytes) -> tuple[int, OnBoardFriction] | None:
    """Return what a line of the service's JSON says of a clutch; None if it says nothing of one, or is none."""
    try:
        record = json.loads(line)
        if record.get("schema") != SHIFT_SCHEMA:
            return None
        verdict = record["verdict"]
        clutch, fluid = int(verdict["clutch"]), FluidVerdict(verdict["condition"])
        friction = verdict["friction"] or {}
        end_ns = int(record.get("end_bus_ns") or 0)
        known = {name: float(friction.get(name, math.nan)) for name in _QUANTITIES}
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
        return None
    return (clutch, OnBoardFriction(fluid=fluid, end_ns=end_ns, **known)) if clutch in CLUTCHES else None
