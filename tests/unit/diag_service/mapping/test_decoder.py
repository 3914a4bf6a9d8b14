"""Frames become canonical columns in SI units; what does not fit or may not be used is told and counted."""

from dataclasses import replace
from pathlib import Path
from typing import Final

import cantools
import numpy as np
import pytest
from cantools.database.can import Database

from canlog.e2e.protection_check import FrameReason
from canlog.frames import ERROR_FLAG, FrameBatch, empty_batch, join
from clutch_model.units import pa_from_bar, rad_s_from_rpm
from diag_service.diagnosis.columns import BALANCE_SIGNALS, Signal
from diag_service.errors import ConfigError
from diag_service.mapping.decoder import Decoder
from diag_service.mapping.profile import Profile, SignalSource, load_profile
from ecu_emulator.bus.frames import EncodedFrames, FrameEncoder
from ecu_emulator.drive.build import ROAD_MESSAGES
from ecu_emulator.sensing import Readings
from tests.support import wire
from tests.support.batches import frames_at
from tests.support.wire import CONTRACTS, DATABASE, START_NS, drive, of_message

TCU_SHIFT: Final = CONTRACTS["TCU_Shift"].can_id
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


def test_frames_that_no_signal_needs_are_ignored() -> None:
    batch = received(drive(0.5))
    other = FrameBatch(t_ns=batch.t_ns, can_id=batch.can_id + np.uint32(0x400), length=batch.length, data=batch.data)
    stage = decoder()
    (columns,) = stage.feed(other)
    assert not columns.columns
    assert not len(columns.bad_frame_ns)
    assert columns.watermark_ns == batch.t_ns[-1]
    assert stage.counts.ignored == stage.counts.on_bus == len(batch)


def test_empty_batch_gives_nothing() -> None:
    stage = decoder()
    assert stage.feed(empty_batch()) == []
    assert stage.counts.on_bus == 0
    assert stage.counts.is_balanced


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


def test_silence_of_up_to_a_second_is_no_jump() -> None:
    batch = received(drive(0.1))
    later = replace(batch, t_ns=batch.t_ns + (batch.t_ns[-1] - batch.t_ns[0]) + 1_000_000_000)
    assert len(decoder().feed(join([batch, later]))) == 1


def test_jump_at_every_frame() -> None:
    batch = of_message(received(drive(0.05)), "TCU_Shift")
    backwards = FrameBatch(t_ns=batch.t_ns[::-1].copy(), can_id=batch.can_id, length=batch.length, data=batch.data)
    parts = decoder().feed(backwards)
    assert [part.breaks_before for part in parts] == [False, True, True, True, True]


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


def test_what_a_lenient_profile_names_in_vain_is_left_out() -> None:
    odd = profile(current_gear=SignalSource(message="TCU_Gears", signal="CurrentGear"))
    stage = Decoder(DATABASE, replace(odd, is_lenient=True))
    assert stage.signals == odd.sources.keys() - {Signal.CURRENT_GEAR}


def test_a_database_from_before_the_road_serves_as_well() -> None:
    """What a profile calls optional may be missing, even where everything else must be there."""
    messages = [message for message in DATABASE.messages if message.name not in ROAD_MESSAGES]
    earlier = Database(messages=messages)
    stage = Decoder(earlier, load_profile())
    assert decoder().signals - stage.signals == decoder().optional_signals != frozenset()
    sources = {signal: replace(source, optional=False) for signal, source in load_profile().sources.items()}
    with pytest.raises(ConfigError, match="TCU_Drive"):
        Decoder(earlier, replace(load_profile(), sources=sources))


def test_signals_may_be_left_out() -> None:
    names = {*BALANCE_SIGNALS, Signal.CURRENT_GEAR, Signal.TARGET_GEAR, Signal.SUMP_TEMPERATURE}
    few = Profile(name="few", sources={s: source for s, source in load_profile().sources.items() if s in names})
    stage = Decoder(DATABASE, few)
    batch = received(drive(1.0))
    (columns,) = stage.feed(batch)
    assert columns.columns.keys() == names == stage.signals
    assert stage.counts.ignored == np.isin(batch.can_id, [0x0A8, 0x0B2, 0x0C0, 0x0C1, 0x0D0]).sum()
    assert stage.counts.is_balanced


def test_foreign_database_without_protection() -> None:
    signals = "\n".join(
        f' SG_ S{k} : {8 * (k % 8)}|8@1+ (1,0) [0|0] "{unit}" A'
        for k, unit in enumerate(("rpm", "Nm", "rpm", "rpm", "rpm", "bar", "bar", ""))
    )
    text = f'VERSION ""\nBU_: A\nBO_ 256 M: 8 A\n{signals}\nBO_ 257 N: 8 A\n SG_ T : 7|16@0+ (0.5,-40) [0|0] "degC" A\n'
    database = cantools.database.load_string(text, "dbc")
    assert isinstance(database, Database)
    names = (
        "engine_speed_rad_s",
        "engine_torque_nm",
        "hub_speed_rad_s",
        "input1_speed_rad_s",
        "input2_speed_rad_s",
        "clutch1_pressure_pa",
        "clutch2_pressure_pa",
        "current_gear",
    )
    sources = {Signal(name): SignalSource(message="M", signal=f"S{k}") for k, name in enumerate(names)}
    sources[Signal.TARGET_GEAR] = SignalSource(message="M", signal="S7", scale=2.0)
    sources[Signal.SUMP_TEMPERATURE] = SignalSource(message="N", signal="T")
    stage = Decoder(database, Profile(name="foreign", sources=sources))
    data = np.array([[1, 2, 3, 4, 5, 6, 7, 3], [1, 0, 0, 0, 0, 0, 0, 0]], np.uint8)
    can_id, length = np.array([0x100, 0x101], np.uint32), np.full(2, 8, np.uint8)
    (columns,) = stage.feed(FrameBatch(t_ns=np.array([0, 0]), can_id=can_id, length=length, data=data))
    value = {signal: series.value.tolist() for signal, series in columns.columns.items()}
    assert value[Signal.INPUT1_SPEED] == [rad_s_from_rpm(4.0)]
    assert value[Signal.CURRENT_GEAR] == [3.0]
    assert value[Signal.TARGET_GEAR] == [6.0]
    assert value[Signal.SUMP_TEMPERATURE] == [0.5 * 256 - 40 + 273.15]
    assert columns.columns[Signal.HUB_SPEED].sequence.tolist() == [-1]
    assert columns.columns[Signal.HUB_SPEED].period_ns == 0


def test_a_controller_that_left_the_bus_ends_the_segment() -> None:
    batch = received(drive(1.0))
    batch.can_id[500] = ERROR_FLAG | 0x40
    stage = decoder()
    before, after = stage.feed(batch)
    assert (before.breaks_before, after.breaks_before) == (False, True)
    assert after.watermark_ns == batch.t_ns[-1]
    assert stage.counts.rejected == {"remote_or_error": 1}
    assert stage.counts.is_balanced


def test_an_interruption_ends_the_segment_without_a_jump_of_time() -> None:
    batch = received(drive(1.0))
    stage = decoder()
    (first,) = stage.feed(batch[:500])
    stage.interrupt()
    (second,) = stage.feed(batch[500:])
    assert (first.breaks_before, second.breaks_before) == (False, True)


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


def test_named_sender_and_several_of_them() -> None:
    (columns,) = truck(source_address=5).feed(eec1([0x11, 0x05, 0x11]))
    assert columns.columns[Signal.ENGINE_SPEED].value.tolist() == [rad_s_from_rpm(64.0)]
    sources = {
        **load_profile().sources,
        Signal.PEDAL: SignalSource(message="TCU_Shift", signal="CurrentGear", unit="%", source_address=1),
        Signal.CURRENT_GEAR: SignalSource(message="TCU_Shift", signal="CurrentGear", source_address=2),
    }
    with pytest.raises(ConfigError, match="several source addresses for TCU_Shift"):
        Decoder(DATABASE, Profile(name="torn", sources=sources))


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
