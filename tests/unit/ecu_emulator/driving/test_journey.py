"""Trips become one stream of rows; the plant is a stand-in that rolls along and warms up."""

import numpy as np
import pytest

from canlog.arrays import FloatArray
from ecu_emulator.driving.journey import Departure, Journey, PlannedTrip, Warmth
from ecu_emulator.driving.trace import SpeedTrace
from ecu_emulator.plant.state import Col

AIR_K = 263.15
START = Warmth(oil_k=303.15, coolant_k=313.15)
SPEED_M_S = 10.0
WARMER_K_S = 1.0


def trip(duration_s: float, parked_s: float = 0.0) -> PlannedTrip:
    trace = SpeedTrace(
        name="made up", t_s=np.array([0.0, duration_s]), speed_m_s=np.full(2, SPEED_M_S), grade_ratio=np.zeros(2)
    )
    return PlannedTrip(trace=trace, parked_s=parked_s)


class Rolling:
    """A car without a powertrain, which gets warmer by a kelvin each second."""

    def __init__(self, departure: Departure) -> None:
        t_s = np.arange(round(departure.trip.trace.duration_s * 1000)) / 1000.0
        self._rows = np.zeros((len(t_s), len(Col)))
        self._rows[:, Col.T_S] = t_s
        self._rows[:, Col.DISTANCE] = SPEED_M_S * t_s
        self._rows[:, Col.SUMP_TEMPERATURE] = departure.warmth.oil_k + WARMER_K_S * t_s
        self._rows[:, Col.COOLANT_TEMPERATURE] = departure.warmth.coolant_k + WARMER_K_S * t_s

    @property
    def finished(self) -> bool:
        return not len(self._rows)

    def believe(self, touch_pressures_pa: tuple[float, float]) -> None:
        """Let the control take these for its clutches' touch points."""

    def advance(self, duration_s: float) -> FloatArray:
        count = round(duration_s * 1000)
        rows, self._rows = self._rows[:count], self._rows[count:]
        return rows


def journey(*trips: PlannedTrip, longest_stay_s: float = np.inf) -> Journey:
    return Journey(iter(trips), Rolling, START, AIR_K, longest_stay_s)


def driven(one: Journey, stretch_s: float) -> list[FloatArray]:
    stretches = []
    while not one.finished:
        stretches.append(one.advance(stretch_s))
    return stretches


def test_clock_and_way_go_on_and_the_car_stands_in_between() -> None:
    rows = np.concatenate(driven(journey(trip(1.5), trip(2.0, 30.0)), 10.0))
    np.testing.assert_array_equal(rows[:1500, Col.T_S], np.arange(1500) / 1000.0)
    np.testing.assert_array_equal(rows[1500:, Col.T_S], np.arange(31_500, 33_500) / 1000.0)
    assert np.diff(rows[:, Col.DISTANCE]).min() >= 0.0
    assert rows[-1, Col.DISTANCE] == pytest.approx(SPEED_M_S * 3.5, abs=0.03)


def test_a_long_stay_is_left_out_but_cools_the_car_all_the_same() -> None:
    whole, short = (journey(trip(1.0), trip(1.0, 7200.0), longest_stay_s=stay_s) for stay_s in (np.inf, 10.0))
    departures = []
    for one in (whole, short):
        driven(one, 10.0)
        assert one.departure is not None
        departures.append(one.departure)
    assert [departure.t_start_s for departure in departures] == [7201.0, 11.0]
    assert departures[0].warmth == departures[1].warmth
    assert departures[0].warmth.oil_k == pytest.approx(AIR_K + (START.oil_k + 1.0 - AIR_K) * np.exp(-0.8), abs=0.01)
