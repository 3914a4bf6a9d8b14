"""Frames become canonical columns in SI units; what does not fit or may not be used is told and counted."""

from dataclasses import replace
from pathlib import Path
from typing import Final

import cantools
import numpy as np
import pytest
from cantools.database.can import Database

from canlog.e2e.protection_check import FrameReason
from canlog.frames import ERROR_FLAG, FrameBatch, join
from clutch_model.units import pa_from_bar, rad_s_from_rpm
from diag_service.diagnosis.columns import Signal
from diag_service.errors import ConfigError
from diag_service.mapping.decoder import Decoder
from diag_service.mapping.profile import Profile, SignalSource, load_profile
from ecu_emulator.bus.frames import EncodedFrames, FrameEncoder
from ecu_emulator.sensing import Readings
from tests.support import wire
from tests.support.batches import frames_at
from tests.support.wire import CONTRACTS, DATABASE, START_NS, drive

CORNERS: Final = Path(__file__).parents[3] / "data" / "corners.dbc"


def decoder() -> Decoder:
    return Decoder(DATABASE, load_profile())


def received(frames: EncodedFrames) -> FrameBatch:
    """Return the frames of the messages that the profile follows; the emulated car sends others, too."""
    followed = {source.message for source in load_profile().sources.values()}
    batch = wire.received(frames)
    return batch[np.isin(batch.can_id, [CONTRACTS[name].can_id for name in followed])]


def test_undisturbed_drive() -> None:
    batch = received(drive(2.0))
    stage = decoder()
    (columns,) = stage.feed(batch)
    assert stage.signals == load_profile().sources.keys()
    assert columns.columns.keys() == stage.seen == stage.signals - stage.optional_signals
    assert columns.watermark_ns == batch.t_ns[-1]
    assert not columns.breaks_before
    assert not len(columns.bad_frame_ns)
    counts = stage.counts
    assert (counts.on_bus, counts.decoded, counts.missing, counts.invalid_values) == (len(batch), len(batch), 0, 0)
    assert not counts.rejected
    assert stage.messages["TCU_Shift"].decoded == 200
    series = columns.columns[Signal.CLUTCH1_PRESSURE]
    assert series.period_ns == 10_000_000
    assert series.sequence.tolist() == list(range(200))
    assert series.t_ns.tolist() == [START_NS + 1_000_000 + 10_000_000 * k for k in range(200)]


def test_values_arrive_in_si_units() -> None:
    values = {
        "clutch1_pressure_pa": np.array([2.5e5]),
        "clutch2_pressure_pa": np.array([-0.31e5]),
        "clutch1_pressure_command_pa": np.array([1e5]),
        "clutch2_pressure_command_pa": np.array([0.0]),
    }
    frames = FrameEncoder(DATABASE).encode(Readings(message="TCU_Pressures", t_s=np.zeros(1), values=values))
    (columns,) = decoder().feed(received(frames))
    assert {signal.value: series.value.tolist() for signal, series in columns.columns.items()} == {
        quantity: pytest.approx(value.tolist()) for quantity, value in values.items()
    }
    assert columns.columns[Signal.CLUTCH1_PRESSURE].value[0] == pa_from_bar(350 * 0.01 - 1)


def test_not_available_values_are_left_out_and_counted() -> None:
    values = {quantity: np.full(3, 100.0) for quantity in FrameEncoder(DATABASE).quantities("TCU_InputSpeeds")}
    values["hub_speed_rad_s"] = np.array([100.0, np.nan, 102.0])
    values["input2_speed_rad_s"] = np.full(3, np.nan)
    t_s = np.array([0.0, 0.01, 0.02])
    frames = FrameEncoder(DATABASE).encode(Readings(message="TCU_InputSpeeds", t_s=t_s, values=values))
    stage = decoder()
    (columns,) = stage.feed(received(frames))
    assert columns.columns[Signal.HUB_SPEED].sequence.tolist() == [0, 2]
    assert columns.columns[Signal.INPUT1_SPEED].sequence.tolist() == [0, 1, 2]
    assert Signal.INPUT2_SPEED not in columns.columns
    assert stage.counts.invalid == {
        "hub_speed_rad_s": {"not_available": 1},
        "input2_speed_rad_s": {"not_available": 3},
    }
    assert stage.counts.invalid_values == 4
    assert stage.counts.invalid_at_first == {"input2_speed_rad_s": 3}
    assert stage.counts.decoded == 3


@pytest.mark.parametrize("cut", range(1, 6))
def test_values_before_the_first_real_one_are_told_apart_wherever_the_stream_is_cut(cut: int) -> None:
    values = {quantity: np.full(6, 100.0) for quantity in FrameEncoder(DATABASE).quantities("TCU_InputSpeeds")}
    values["hub_speed_rad_s"] = np.array([np.nan, np.nan, 100.0, np.nan, 101.0, np.nan])
    readings = Readings(message="TCU_InputSpeeds", t_s=np.linspace(0.0, 0.05, 6), values=values)
    batch = received(FrameEncoder(DATABASE).encode(readings))
    stage = decoder()
    for part in (batch[:cut], batch[cut:]):
        stage.feed(part)
    assert stage.counts.invalid == {"hub_speed_rad_s": {"not_available": 4}}
    assert stage.counts.invalid_at_first == {"hub_speed_rad_s": 2}


def test_bad_and_missing_frames_are_timed() -> None:
    batch = received(drive(1.0))
    shift_rows = np.flatnonzero(batch.can_id == CONTRACTS["TCU_Shift"].can_id)
    batch.data[shift_rows[5], 0] ^= 1
    kept = np.delete(np.arange(len(batch)), shift_rows[[20, 21]])
    lossy = batch[kept]
    stage = decoder()
    (columns,) = stage.feed(lossy)
    expected = batch.t_ns[shift_rows[[5, 22, 22]]]
    assert columns.bad_frame_ns.tolist() == expected.tolist()
    counts = stage.counts
    assert stage.messages["TCU_Shift"].rejected == {FrameReason.BAD_CRC: 1}
    assert stage.messages["TCU_Shift"].missing == counts.missing == 2
    assert counts.rejected == {"bad_crc": 1}
    assert counts.decoded + sum(counts.rejected.values()) + counts.missing == len(batch)
    assert counts.is_balanced


@pytest.mark.parametrize("shift_ns", [-1000, -3_600_000_000_000, 1_000_001_000, 86_400_000_000_000])
@pytest.mark.parametrize("together", [True, False])
def test_jump_of_bus_time_starts_a_new_segment(shift_ns: int, together: bool) -> None:
    first = received(drive(0.5))
    later_ns = first.t_ns + (first.t_ns[-1] - first.t_ns[0]) + shift_ns
    second = FrameBatch(t_ns=later_ns, can_id=first.can_id, length=first.length, data=first.data)
    stage = decoder()
    parts = stage.feed(join([first, second])) if together else [*stage.feed(first), *stage.feed(second)]
    assert [part.breaks_before for part in parts] == [False, True]
    assert [part.watermark_ns for part in parts] == [first.t_ns[-1], later_ns[-1]]
    assert stage.counts.decoded == 2 * len(first)
    assert stage.counts.missing == 0
    sequences = [part.columns[Signal.HUB_SPEED].sequence.tolist() for part in parts]
    assert sequences == [list(range(50)), list(range(50, 100))]


def profile(**changes: SignalSource | None) -> Profile:
    sources = {signal.value: source for signal, source in load_profile().sources.items()} | changes
    return Profile(name="test", sources={Signal(key): source for key, source in sources.items() if source is not None})


def test_everything_that_does_not_fit_is_listed() -> None:
    wrong = profile(
        current_gear=SignalSource(message="TCU_Gears", signal="CurrentGear"),
        target_gear=SignalSource(message="TCU_Shift", signal="NextGear"),
        odometer_m=SignalSource(message="BRK_Vehicle", signal="VehicleSpeed"),
    )
    with pytest.raises(ConfigError) as refused:
        Decoder(DATABASE, wrong)
    text = str(refused.value)
    for complaint in (
        "no message TCU_Gears (for current_gear)",
        "TCU_Shift has no signal NextGear (for target_gear)",
        "the unit 'km/h' of BRK_Vehicle.VehicleSpeed is not one of odometer_m (for odometer_m)",
    ):
        assert complaint in text
    assert "\n" not in text


def test_a_controller_that_left_the_bus_ends_the_segment() -> None:
    batch = received(drive(1.0))
    batch.can_id[500] = ERROR_FLAG | 0x40
    stage = decoder()
    before, after = stage.feed(batch)
    assert (before.breaks_before, after.breaks_before) == (False, True)
    assert after.watermark_ns == batch.t_ns[-1]
    assert stage.counts.rejected == {"remote_or_error": 1}
    assert stage.counts.is_balanced


def truck(**more: object) -> Decoder:
    """Return a decoder of a truck's engine speed beside this project's own messages."""
    corners = cantools.database.load_file(CORNERS)
    assert isinstance(corners, Database)
    messages = [*DATABASE.messages, corners.get_message_by_name("EEC1")]
    sources = dict(load_profile().sources)
    sources[Signal.ENGINE_SPEED] = SignalSource(message="EEC1", signal="EngSpeed", **more)  # type: ignore[arg-type]
    return Decoder(Database(messages), Profile(name="truck", sources=sources))


def eec1(senders: list[int], channels: list[int] | None = None) -> FrameBatch:
    """Return engine speeds in steps of 32 rpm, a second apart in all."""
    count = len(senders)
    data = np.zeros((count, 8), np.uint8)
    data[:, 4] = np.arange(1, count + 1)
    can_ids = [0x8CF0_0400 | sender for sender in senders]
    return frames_at(START_NS + np.arange(count) * 20_000_000, can_ids, data=data, channel=channels or 0)


def test_one_sender_of_a_parameter_group_gives_the_values_and_the_others_do_no_harm() -> None:
    stage = truck()
    (columns,) = stage.feed(eec1([0x11, 0x05, 0x11, 0x05, 0x11]))
    assert columns.columns[Signal.ENGINE_SPEED].value.tolist() == rad_s_from_rpm(np.array([32.0, 96.0, 160.0])).tolist()
    assert not len(columns.bad_frame_ns)
    counts = stage.counts
    assert counts.is_balanced
    assert counts.rejected == {"other_sender": 2}
    assert stage.messages["EEC1"].senders == {0x05: 2, 0x11: 3}


def test_one_identifier_on_two_channels_is_never_mixed() -> None:
    batch = received(drive(1.0))
    rows = np.repeat(np.arange(len(batch)), 2)
    twice = replace(batch[rows], channel=np.tile(np.array([1, 2], np.uint8), len(batch)))
    twice.data[1::2, 2:] ^= 0xFF  # the other bus says something else
    alone, both, named = decoder(), decoder(), Decoder(DATABASE, replace(load_profile(), channel=1))
    (wanted,) = alone.feed(batch)
    for stage in (both, named):
        (columns,) = stage.feed(twice)
        for signal, series in wanted.columns.items():
            assert np.array_equal(columns.columns[signal].value, series.value)
        assert not len(columns.bad_frame_ns)
        assert stage.counts.rejected == {"other_channel": len(batch)}
        assert stage.messages["TCU_Shift"].channels == {1: 100, 2: 100}
        assert stage.counts.is_balanced
