"""Bad events and juddering launches as the studies count them."""

import numpy as np
import pytest

from benchmarks.poison import PRESSURES_PA, TORQUES_NM, Setting, Step, bad, is_followed
from benchmarks.stick_slip import Launch, counts
from diag_service.diagnosis.columns import Signal
from ecu_emulator.scenario.scenario_file import load_scenario
from tests.unit.diag_service.diagnosis.shifts_of_a_drive import first_shifts


@pytest.mark.parametrize("kind", ["drift", "offset", "spike"])
@pytest.mark.parametrize(
    ("signal", "sizes"), [(Signal.ENGINE_TORQUE, TORQUES_NM), (Signal.CLUTCH1_PRESSURE, PRESSURES_PA)]
)
def test_one_sensor_errs_by_what_is_said_and_no_other(kind: str, signal: Signal, sizes: dict[str, float]) -> None:
    event = first_shifts()[0]
    spoilt = bad(event, signal, kind, -1.0)
    error = spoilt.columns[signal].value - event.columns[signal].value
    assert all(spoilt.columns[one] is event.columns[one] for one in event.columns if one is not signal)
    per = (event.columns[signal].t_ns[-1] - event.start_ns) * 1e-9 if kind == "drift" else 1.0
    assert error.min() == pytest.approx(-sizes[kind] * per)
    assert error.max() == pytest.approx(-sizes[kind] if kind == "offset" else 0.0)
    assert kind != "spike" or np.count_nonzero(error) <= 6


def test_a_changeis_followed_if_most_of_it_is_made_within_four_events() -> None:
    def step(*errors: float) -> Step:
        return Step(clutch=1, step_ratio=0.06, errors_ratio=errors, stds_ratio=(0.01,) * len(errors))

    assert is_followed(step(-0.06, -0.04, -0.02, -0.01))
    assert not is_followed(step(-0.06, -0.05, -0.04, -0.04))
    assert not is_followed(step(-0.01, -0.01))  # there were no four
    assert is_followed(step(-0.06, -0.05, -0.04, -0.04, -0.01), 5)


@pytest.mark.parametrize(("oil_degc", "count"), [(None, 4), (60.0, 4), (45.0, 8)])
def test_oil_is_as_warm_as_said_and_a_change_has_more_events_where_it_is_cool(
    oil_degc: float | None, count: int
) -> None:
    setting, base = Setting(oil_degc=oil_degc), load_scenario("noise_only")
    assert setting.followed_events == count
    expected_k = base.ambient.oil_temperature_k if oil_degc is None else 273.15 + oil_degc
    driven = setting.scenario(base)
    assert driven.ambient.oil_temperature_k == pytest.approx(expected_k)
    assert oil_degc is None or driven.ambient.coolant_temperature_k == driven.ambient.oil_temperature_k


def test_launches_are_counted_by_what_truly_happened() -> None:
    pairs = [(9.0, 8.0), (9.0, 1.0), (9.0, None), (0.5, 0.6), (0.5, 7.0)]
    found = [Launch(fluid="ideal", true_rad_s=true, found_rad_s=seen) for true, seen in pairs]
    assert counts(found) == (3, 1, 2, 1)
