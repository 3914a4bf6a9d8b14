"""A car whose time is the caller's: the same frames as recorded, or gears and clutches that follow another's speed."""

import can
import numpy as np
import pytest

from canlog.e2e.message_contract import message_contracts
from canlog.e2e.profile1 import counter_of, protect
from dbc.contract import load_contract
from ecu_emulator import Emulator, EmulatorConfigError
from ecu_emulator.bus.sent_values import SentValues
from ecu_emulator.drive.recording import frames_of
from ecu_emulator.drive.stepping import StepGrid
from workshop import Answers

CONTRACTS = {contract.can_id: contract for contract in message_contracts(load_contract("nominal")).values()}


def test_stepping_gives_the_recorded_frames_to_the_bit() -> None:
    car = Emulator("case2", seed=7, faults=[{"kind": "loss", "share": 0.1}])
    recorded, _ = frames_of(car.scenario)
    stepped = [message for _ in range(700) for message in car.step(0.01)]
    stepped += [message for duration_s in (0.001, 0.25, 1.0) for message in car.step(duration_s)]
    assert len(stepped) > 4000
    assert car.sent_s == pytest.approx(7.0 + 1.251, abs=0.002)
    assert [message.timestamp for message in stepped] == recorded.t_s[: len(stepped)].tolist()
    assert [message.arbitration_id for message in stepped] == recorded.can_id[: len(stepped)].tolist()
    assert [bytes(message.data) for message in stepped] == [bytes(row) for row in recorded.data[: len(stepped)]]
    assert [shift.number for shift in car.truth.shifts] == [1, 2, 3]


def test_the_end_of_a_drive_is_seen() -> None:
    car = Emulator("ideal", cycles=1)
    assert not car.is_driving
    while car.step(1.0):
        assert car.truth.drive.scenario == "ideal"
    assert not car.is_driving
    assert car.step(1.0) == []


def heard(car: Emulator, values: SentValues, speed_m_s: float, pedal_ratio: float) -> list[can.Message]:
    messages = car.step(0.01, speed_m_s, pedal_ratio)
    for message in messages:
        values.note(message.arbitration_id, bytes(message.data), message.timestamp)
    return messages


def test_somebody_else_moves_the_car_and_counters_and_checksums_go_on() -> None:
    car, values = Emulator("ideal"), SentValues(load_contract("nominal"))
    frames = list[can.Message]()
    for step in range(1000):
        frames += heard(car, values, min(1.5 * max(step - 100, 0) * 0.01, 12.0), 0.35 if step > 100 else 0.0)
    known = values.now({})
    assert known["vehicle_speed_m_s"] == pytest.approx(12.0, abs=0.3)
    assert known["pedal_ratio"] == pytest.approx(0.35, abs=0.005)
    assert known["current_gear"] >= 2.0
    assert known["wheel_fl_speed_m_s"] == pytest.approx(12.0, rel=0.03)
    assert car.truth.shifts[0].to_gear == 2
    for step in range(600):
        frames += heard(car, values, max(12.0 - 2.5 * step * 0.01, 0.0), 0.0)
    known = values.now({})
    assert known["vehicle_speed_m_s"] == pytest.approx(0.0, abs=0.1)
    assert known["current_gear"] == 1.0
    assert known["brake_pressure_pa"] > 5e5
    for can_id, contract in CONTRACTS.items():
        data = np.array([list(message.data) for message in frames if message.arbitration_id == can_id], np.uint8)
        counters = counter_of(data).astype(np.int64)
        assert len(data) > 10
        assert set(np.diff(counters).tolist()) <= {1, 1 - (int(counters.max()) + 1)}
        assert (protect(data, contract.data_id or 0, counters) == data).all()


@pytest.mark.parametrize(
    ("step", "text"),
    [
        ((0.0,), "duration_s must be above 0, up to 600, got 0"),
        ((-0.01,), "duration_s must be"),
        ((float("nan"),), "duration_s must be above 0, up to 600, got nan"),
        ((float("inf"),), "duration_s must be above 0, up to 600, got inf"),
        ((float("nan"), 5.0, 0.2), "duration_s must be"),
        ((1e6,), "duration_s must be"),
        ((0.01, 5.0), "belong together"),
        ((0.01, -1.0, 0.2), "speed_m_s must be 0..100, got -1"),
        ((0.01, 1e6, 0.2), "speed_m_s must be 0..100, got 1e\\+06"),
        ((0.01, 5.0, 1.2), "pedal_ratio must be 0..1, got 1.2"),
        ((0.01, float("nan"), 0.2), "speed_m_s must be 0..100, got nan"),
        ((0.01, 5.0, float("nan")), "pedal_ratio must be 0..1, got nan"),
    ],
)
def test_a_step_that_cannot_be_says_so(step: tuple[float, ...], text: str) -> None:
    with pytest.raises(EmulatorConfigError, match=text):
        Emulator("ideal").step(*step)


@pytest.mark.parametrize("ticks_per_s", [30, 60, 144])
def test_the_ticks_of_games_neither_drift_nor_change_a_frame(ticks_per_s: int) -> None:
    """Each tick ends at the millisecond nearest to it; the frames are those of any other steps."""
    game, other = Emulator("case2", seed=7), Emulator("case2", seed=7)
    ticks = [game.step(1.0 / ticks_per_s) for _ in range(4 * ticks_per_s)]
    whole = [message for _ in range(4) for message in other.step(1.0)]
    assert game.sent_s == other.sent_s
    assert [(frame.timestamp, bytes(frame.data)) for tick in ticks for frame in tick] == [
        (frame.timestamp, bytes(frame.data)) for frame in whole
    ]


@pytest.mark.parametrize("duration_s", [1.0 / 30.0, 1.0 / 60.0, 0.1])
def test_an_hour_of_steps_is_an_hour(duration_s: float) -> None:
    grid, driven_ms = StepGrid(), 0
    for count in range(1, round(3600.0 / duration_s) + 1):
        driven_ms += grid.whole_ms(duration_s)
        assert abs(driven_ms - 1000.0 * count * duration_s) < 0.51
    assert driven_ms == pytest.approx(3_600_000, abs=1)


def test_numbers_that_are_none_are_refused_by_all_that_waits_and_asks() -> None:
    with Emulator("ideal", drive="city") as car:
        for gear in (float("nan"), float("inf"), 2.5):
            with pytest.raises(EmulatorConfigError, match=r"gear must be a whole number, 1\.\.6"):
                car.request_gear(gear)  # type: ignore[arg-type]  # what a caller without types may hand over
        with pytest.raises(EmulatorConfigError, match="t_s must be a number, got nan"):
            car.wait_until(float("nan"), 1.0)
        with pytest.raises(EmulatorConfigError, match="timeout_s must be a number, got nan"):
            car.wait_until(1.0, float("nan"))
        with pytest.raises(EmulatorConfigError, match="timeout_s must be a number, got nan"):
            car.wait(float("nan"))


def shown_of(car: Emulator, course: list[tuple[float, float]]) -> dict[str, list[float]]:
    """Return speeds and gears that the bus shows after each hundredth of a second at these speeds and pedals.

    Lists end with the course; they begin when a quantity is first known.
    """
    values = SentValues(load_contract(car.scenario.transmission))
    shown: dict[str, list[float]] = {}
    for speed_m_s, pedal_ratio in course:
        heard(car, values, speed_m_s, pedal_ratio)
        for name, value in values.now({}).items():
            shown.setdefault(name, []).append(value)
    return shown


FAST_M_S = 100.0 / 3.6
SHAFTS = ("input1_speed_rad_s", "input2_speed_rad_s", "turbine_speed_rad_s")
HIGHEST_RAD_S = 650.0  # the limiter begins at 600 rad/s and leaves no torque at 640
SETTLED_RAD_S = {("lockup", 1.0): 640.0}  # a converter slips: at full pedal the limiter holds its engine


def driven_off(last_m_s: float) -> list[tuple[float, float]]:
    """Return the hundredths of a second in which a car gets this fast on its road, and stays so for two seconds."""
    return [(min(2.5 * 0.01 * tick, last_m_s), 0.3) for tick in range(round(40.0 * last_m_s) + 200)]


@pytest.mark.parametrize(
    ("scenario", "pedal_ratio"),
    [(name, pedal_ratio) for name in ("ideal", "lockup") for pedal_ratio in (0.0, 0.3, 1.0)],
)
def test_a_car_that_is_moved_at_once_finds_its_gear_anew(scenario: str, pedal_ratio: float) -> None:
    """A game sets a car on the road at 100 km/h, and stops it at a wall: both within one tick."""
    start, fast, stopped = [(0.0, 0.0)] * 100, [(FAST_M_S, pedal_ratio)] * 700, [(0.0, 0.0)] * 400
    shown = shown_of(Emulator(scenario), [*start, *fast, *stopped])
    engine_rad_s = shown["engine_speed_rad_s"]
    assert max(engine_rad_s) < HIGHEST_RAD_S
    assert max(engine_rad_s[-600:]) < SETTLED_RAD_S.get((scenario, pedal_ratio), 600.0)
    assert shown["current_gear"][-401] >= 2.0
    assert shown["current_gear"][-1] == 1.0
    assert shown["vehicle_speed_m_s"][-1] == pytest.approx(0.0, abs=0.1)
    assert max(max(shown[name][-100:]) for name in SHAFTS if name in shown) < 20.0


@pytest.mark.parametrize("pedal_ratio", [0.0, 0.3])
def test_a_car_in_its_highest_gear_that_is_stopped_at_once_is_in_first_gear(pedal_ratio: float) -> None:
    shown = shown_of(Emulator("ideal"), [*driven_off(FAST_M_S), *[(0.0, pedal_ratio)] * 300])
    assert shown["current_gear"][-301] >= 4.0
    assert shown["current_gear"][-1] == 1.0
    assert max(shown["engine_speed_rad_s"]) < HIGHEST_RAD_S
    for name in ("input1_speed_rad_s", "input2_speed_rad_s"):
        assert max(shown[name][-300:]) < 400.0
        assert shown[name][-1] < 20.0


def test_a_car_in_a_low_gear_that_is_moved_at_once_spares_its_engine() -> None:
    shown = shown_of(Emulator("ideal"), [*driven_off(6.0), *[(40.0, 0.3)] * 500])
    assert shown["current_gear"][-501] <= 2.0
    assert shown["current_gear"][-1] >= 4.0
    assert max(shown["engine_speed_rad_s"][-400:]) < HIGHEST_RAD_S


def test_hard_braking_turns_no_wheel_backwards() -> None:
    """Brakes give what the tyres hold; what slows a steered car down beyond that, a wall perhaps, is no brake."""
    course = driven_off(FAST_M_S)
    shown = shown_of(Emulator("ideal"), [*course, *[(max(FAST_M_S - 0.3 * tick, 0.0), 0.0) for tick in range(200)]])
    for name in ("input1_speed_rad_s", "input2_speed_rad_s"):
        assert max(shown[name][-200:]) < 400.0  # a wheel that runs backwards drives its shafts to the signal's end
        assert shown[name][-1] < 20.0


def test_a_car_has_one_pace_and_one_hand_at_the_wheel() -> None:
    own = Emulator("ideal")
    own.step(0.01)
    with pytest.raises(EmulatorConfigError, match="in each of its steps"):
        own.step(0.01, 5.0, 0.2)
    with pytest.raises(EmulatorConfigError, match="drives only once"), own:
        pass
    with Emulator("ideal") as live, pytest.raises(EmulatorConfigError, match="drives on a bus"):
        live.step(0.01)
    with pytest.raises(EmulatorConfigError, match="answered in real time"):
        Emulator("ideal", answers=Answers()).step(0.01)
