"""Routine 0302 adapts the clutches of a drawn vehicle; what it finds is kept, tested, used and cleared again."""

from dataclasses import dataclass, field

import pytest

from ecu_emulator.scenario.faults import SensorFault, SensorFaultKind
from ecu_emulator.scenario.scenario import Scenario
from tests.support.uds.adapting_car import ADAPT, CLEAR, AdaptingCar, in_workshop, memory_in
from workshop.controller.controller import MemoryFile
from workshop.controller.iso14229 import DtcStatus

NOMINAL_PA = (134_545.0, 150_000.0)
MARGIN_PA = 0.1e5  # above the touch point a filled clutch is held
STRONG_SPRING_N = 850.0  # begins to carry torque about 0.6 bar later
DONE = DtcStatus.TEST_FAILED | DtcStatus.CONFIRMED


@dataclass
class Day:
    """What an operation cycle has left."""

    said: dict[str, str] = field(default_factory=dict)
    codes: dict[str, list[DtcStatus]] = field(default_factory=lambda: {"P0810": [], "P2788": []})
    works_by_pa: list[tuple[float, float]] = field(default_factory=list)
    touch_pa: tuple[float, float] = (0.0, 0.0)
    fills_pa: dict[int, float] = field(default_factory=dict)


def lived(scenario: Scenario, memory: MemoryFile, *requests: str, to_gear: int = 0) -> Day:
    """Let a car start, be asked for routines one after the other, perhaps drive off, and be switched off."""
    day = Day()
    with memory:
        car = AdaptingCar(scenario, memory)
        day.touch_pa = car.touch_pa
        for request in ("", *requests):
            if request:
                day.said[request] = car.perform(request)
                car.go_on()
            for code, statuses in day.codes.items():
                statuses.append(car.status(code))
            day.works_by_pa.append(car.drive.touch_pressures_pa)
            day.said["22 03 10"] = car.ask("22 03 10")
        if to_gear:
            car.drive_off(to_gear)
            day.fills_pa = car.fills_pa
    return day


@pytest.fixture(scope="module", name="days")
def _days(tmp_path_factory: pytest.TempPathFactory) -> list[Day]:
    """Return days of a car: springs too strong to adapt, a second start, other springs, the day after."""
    memory = memory_in(tmp_path_factory.mktemp("car"))
    worn = in_workshop(clutch1=STRONG_SPRING_N, clutch2=STRONG_SPRING_N)
    return [
        lived(worn, memory, ADAPT),
        lived(worn, memory),
        lived(in_workshop(), memory, ADAPT, to_gear=2),
        lived(in_workshop(), memory, CLEAR),
    ]


def test_a_car_that_is_not_adapted_says_so_and_fills_as_its_type_does(days: list[Day]) -> None:
    assert days[0].codes["P0810"][0] & DONE == DONE
    assert days[0].works_by_pa[0] == pytest.approx(NOMINAL_PA, abs=1.0)


def test_touch_points_are_found_within_the_stated_deviation_and_worked_with(days: list[Day]) -> None:
    day = days[2]
    answer = bytes.fromhex(day.said[ADAPT])
    assert (answer[:5].hex(" "), len(answer)) == ("71 01 03 02 00", 15)
    for clutch, piece in enumerate((answer[5:10], answer[10:15])):
        found_pa, std_pa = (10.0 * int.from_bytes(piece[place : place + 2], "big") for place in (1, 3))
        assert piece[0] == 0  # adapted
        assert 0.0 < std_pa < 1_500.0
        assert abs(found_pa - day.touch_pa[clutch]) < 2.0 * std_pa
        assert day.works_by_pa[1][clutch] == pytest.approx(found_pa, abs=5.0)
    before, after = (
        sum(abs(one - other) for one, other in zip(works_by_pa, day.touch_pa, strict=True))
        for works_by_pa in (NOMINAL_PA, day.works_by_pa[1])
    )
    assert after < 0.5 * before
    for gear, clutch in ((1, 0), (2, 1)):
        assert day.fills_pa[gear] - day.touch_pa[clutch] == pytest.approx(
            MARGIN_PA, abs=1_500.0
        )  # by steps of 0.01 bar


def test_adaptation_that_is_done_is_no_fault_any_more_and_is_kept(days: list[Day]) -> None:
    assert not days[2].codes["P0810"][1] & DtcStatus.TEST_FAILED
    assert days[3].works_by_pa[0] == days[2].works_by_pa[1]
    assert not days[3].codes["P0810"][0] & (DtcStatus.TEST_FAILED | DtcStatus.NOT_TESTED_THIS_CYCLE)
    assert days[3].said["22 03 10"] != days[2].said["22 03 10"]  # of each day the last: then it was cleared


def test_a_touch_point_out_of_reach_is_a_code_that_is_confirmed_in_two_cycles_and_heals(days: list[Day]) -> None:
    assert days[0].said[ADAPT] == "71 01 03 02 00 01 3e 53 ff ff 01 44 5c ff ff"  # 0.25 bar above the type's
    first, second, third = (days[place].codes["P2788"] for place in range(3))
    assert first[0] & DtcStatus.NOT_TESTED_THIS_CYCLE
    assert first[1] & (DtcStatus.PENDING | DtcStatus.CONFIRMED) == DtcStatus.PENDING
    assert second[0] & DONE == DONE
    assert third[0] & DONE == DONE  # by what it remembers
    assert third[1] & DONE == DtcStatus.CONFIRMED
    assert days[3].codes["P2788"][0] & (DONE | DtcStatus.FAILED_THIS_CYCLE) == DtcStatus.CONFIRMED


def test_clearing_the_adaptation_returns_to_the_type_and_asks_for_another(days: list[Day]) -> None:
    day = days[3]
    assert day.said[CLEAR] == "71 01 03 03 00"
    assert day.works_by_pa[1] == pytest.approx(NOMINAL_PA, abs=1.0)
    assert day.codes["P0810"][1] & DtcStatus.TEST_FAILED


@pytest.mark.parametrize(
    ("quantity", "size", "nrc"),
    [("brake_pressure_pa", -1e6, "8f"), ("pedal_ratio", 0.5, "8a"), ("vehicle_speed_m_s", 3.0, "88")],
)
def test_what_must_hold_until_the_end_is_watched(quantity: str, size: float, nrc: str) -> None:
    car = AdaptingCar(in_workshop())
    begun_s, is_broken = car.t_s, False

    def break_it() -> None:
        nonlocal is_broken
        if not is_broken and car.t_s > begun_s + 3.0:
            is_broken = True
            car.drive.add_fault(SensorFault(quantity=quantity, kind=SensorFaultKind.OFFSET, size=size))

    assert car.perform(ADAPT, break_it) == f"7f 31 {nrc}"
    for _ in range(8):
        car.go_on()
    assert car.drive.is_waiting  # it has let go
    assert car.controller.state.adaptation is None
