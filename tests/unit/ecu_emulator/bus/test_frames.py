"""Frames as they are sent."""

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from can.io import CanutilsLogReader
from hypothesis import given
from hypothesis import strategies as st

from canlog.arrays import FloatArray
from ecu_emulator.bus.bus_faults import error_frames
from ecu_emulator.bus.frames import SIGNAL_OF, EncodedFrames, FrameEncoder, joined
from ecu_emulator.log_formats import open_log
from ecu_emulator.sensing import Readings
from tests.support.wire import CONTRACTS, DATABASE, drive, readings

TO_DBC_UNIT: dict[str, Callable[[float], float]] = {
    "rad_s": lambda value: value / (math.pi / 30.0),
    "m_s": lambda value: value * 3.6,
    "pa": lambda value: value / 1e5,
    "ratio": lambda value: value * 100.0,
    "k": lambda value: value - 273.15,
}


def dbc_value(quantity: str, value: float) -> float:
    """Return an SI value in the unit of the database, by rules written down here once more."""
    if quantity == "manifold_pressure_pa":
        return value / 1e3
    return next((rule(value) for unit, rule in TO_DBC_UNIT.items() if quantity.endswith(f"_{unit}")), value)


def inputs(**changes: FloatArray) -> Readings:
    values = {
        "engine_speed_rad_s": np.array([100.0]),
        "engine_torque_nm": np.array([50.0]),
        "pedal_ratio": np.array([0.5]),
        "throttle_ratio": np.array([0.25]),
    }
    return Readings(message="ECM_TorqueSpeed", t_s=np.array([0.0]), values=values | changes)


def decoded(frames: EncodedFrames, message: str, row: int = 0) -> dict[str, float]:
    values = DATABASE.get_message_by_name(message).decode(frames.data[row].tobytes(), decode_choices=False)
    assert isinstance(values, dict)
    return {name: float(str(value)) for name, value in values.items()}


@given(st.sampled_from(sorted(CONTRACTS)), st.integers(0, 2**32))
def test_payload_is_what_cantools_encodes(name: str, seed: int) -> None:
    sample = readings(name, np.arange(20.0), np.random.default_rng(seed))
    frames = FrameEncoder(DATABASE).encode(sample)
    message = DATABASE.get_message_by_name(name)
    for row, payload in enumerate(frames.data):
        signals: dict[str, float] = {
            SIGNAL_OF[quantity]: dbc_value(quantity, float(values[row])) for quantity, values in sample.values.items()
        }
        signals |= {"Crc8": int(payload[0]), "AliveCounter": row % 15}
        assert message.encode(signals, strict=True) == payload.tobytes()


@pytest.mark.parametrize(
    ("quantity", "si", "signal", "limit"),
    [
        ("engine_speed_rad_s", -5.0, "EngineSpeed", 0.0),
        ("engine_speed_rad_s", math.inf, "EngineSpeed", 16383.5),
        ("engine_torque_nm", 5000.0, "EngineTorque", 1546.0),
        ("engine_torque_nm", -5000.0, "EngineTorque", -500.0),
        ("pedal_ratio", 1.01, "Pedal", 100.0),
    ],
)
def test_values_out_of_range_saturate(quantity: str, si: float, signal: str, limit: float) -> None:
    frames = FrameEncoder(DATABASE).encode(inputs(**{quantity: np.array([si])}))
    assert decoded(frames, "ECM_TorqueSpeed")[signal] == limit


SOUND = drive(0.02)
FRAMES = joined(SOUND, error_frames(np.array([0.021, 0.022])))


def test_a_candump_log_keeps_them(tmp_path: Path) -> None:
    path = tmp_path / "drive.log"
    with open_log(path) as log:
        log.write(FRAMES)
    with CanutilsLogReader(path) as reader:
        messages = list(reader)
    assert [message.is_error_frame for message in messages] == [False] * len(SOUND) + [True] * 2
    assert path.read_text(encoding="ascii").splitlines()[-1].endswith(" vcan0 20000088#0000040000000000")
