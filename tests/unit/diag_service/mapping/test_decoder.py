"""Frames become canonical columns in SI units; what does not fit or may not be used is told and counted."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from canlog.e2e.protection_check import FrameReason
from canlog.frames import ERROR_FLAG, FrameBatch, join
from canlog.time_order import LATE_NS
from clutch_model.units import pa_from_bar
from diag_service.diagnosis.columns import Signal
from diag_service.errors import ConfigError
from diag_service.mapping.decoder import Decoder
from diag_service.mapping.profile import BusSource, Profile, load_profile
from ecu_emulator.bus.frames import EncodedFrames, FrameEncoder
from ecu_emulator.sensing import Readings
from tests.support import wire
from tests.support.lateness import after_stalls
from tests.support.wire import CONTRACTS, DATABASE, START_NS, drive


def decoder() -> Decoder:
    return Decoder(DATABASE, load_profile())


def received(frames: EncodedFrames) -> FrameBatch:
    """Return the frames of the messages that the profile follows; the emulated car sends others, too."""
    followed = {source.message_name for source in load_profile().sources.values()}
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


def test_frames_held_back_when_a_log_ends_are_used() -> None:
    batch = after_stalls(received(drive(2.0)), [(1.9, 0.09)], 0.0)  # what the last burst was is not yet told
    fed, whole = decoder(), decoder()
    assert list(fed.stream(batch))
    assert fed.counts.decoded < len(batch)
    last = list(whole.whole([batch[:100], batch[100:]]))[-1]
    assert whole.counts.decoded == len(batch)
    assert last.watermark_ns == received(drive(2.0)).t_ns[-1]


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
    assert stage.counts.invalid == {"hub_speed_rad_s": {"not_available": 1}, "input2_speed_rad_s": {"not_available": 3}}
    assert stage.counts.invalid_values == 4
    assert stage.counts.invalid_at_first == {"input2_speed_rad_s": 3}
    assert stage.counts.decoded == 3


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


@pytest.mark.parametrize("shift_ns", [-101_000_000, -3_600_000_000_000, 1_000_001_000, 86_400_000_000_000])
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


def in_batches(frames: FrameBatch, *ends: int) -> list[FrameBatch]:
    return [frames[first:end] for first, end in pairwise([0, *ends, len(frames)])]


def test_live_frames_that_come_behind_later_ones_are_late_and_end_nothing() -> None:
    frames = received(drive(1.0))
    hub = np.flatnonzero(frames.can_id == CONTRACTS["TCU_InputSpeeds"].can_id)[50]
    swapped = np.arange(len(frames))
    swapped[hub : hub + 5] = *range(hub + 1, hub + 5), hub
    stage, straight = decoder(), decoder()
    parts = [part for batch in in_batches(frames[swapped], hub + 4) for part in stage.feed(batch)]
    expected = [part for batch in in_batches(frames, hub + 5) for part in straight.feed(batch)]
    assert [part.breaks_before for part in parts] == [False, False]
    for signal in (Signal.HUB_SPEED, Signal.ENGINE_SPEED):
        samples, sent = (
            np.concatenate([part.columns[signal].t_ns for part in both if signal in part.columns])
            for both in (parts, expected)
        )
        assert samples.tolist() == sent.tolist()
    assert (stage.counts.late, straight.counts.late) == (1, 0)
    assert stage.counts.rejected == {}


def test_a_live_frame_behind_a_later_one_of_its_message_is_out_of_order() -> None:
    frames = received(drive(1.0))
    hubs = np.flatnonzero(frames.can_id == CONTRACTS["TCU_InputSpeeds"].can_id)[50:52]
    kept = np.delete(np.arange(len(frames)), hubs[0])
    at = int(np.flatnonzero(kept == hubs[1])[0]) + 1
    stage = decoder()
    parts = [part for batch in in_batches(frames[np.insert(kept, at, hubs[0])], at) for part in stage.feed(batch)]
    assert [part.breaks_before for part in parts] == [False, False]
    assert stage.counts.rejected == {"out_of_order": 1}
    assert stage.counts.late == 1
    missed_ns, came_ns = frames.t_ns[hubs[::-1]].tolist()
    assert [part.bad_frame_ns.tolist() for part in parts if len(part.bad_frame_ns)] == [[missed_ns], [came_ns]]
    assert stage.counts.is_balanced


@pytest.mark.parametrize("off_ns", [-10_000, -150_000_000, -20_000_000_000, 500_000_000, 5_000_000_000])
def test_frames_of_no_message_end_nothing_and_move_no_watermark_far(off_ns: int) -> None:
    frames = received(drive(1.0))
    others = replace(frames[::7], can_id=np.full(len(frames[::7]), 0x3E9, np.uint32), t_ns=frames.t_ns[::7] + off_ns)
    order = np.argsort(np.concatenate((frames.t_ns, frames.t_ns[::7] + 1)), kind="stable")
    mixed = join([frames, others])[order]
    stage, alone = decoder(), decoder()
    cut = range(50, len(mixed), 50)
    parts = [part for batch in in_batches(mixed, *cut) for part in stage.feed(batch)]
    (whole,) = alone.feed(frames)
    assert not any(part.breaks_before for part in parts)
    samples = np.concatenate([part.columns[Signal.HUB_SPEED].t_ns for part in parts])
    assert samples.tolist() == whole.columns[Signal.HUB_SPEED].t_ns.tolist()
    latest_ns = np.maximum.accumulate([frames.t_ns[0], *frames.t_ns])
    behind = [np.searchsorted(frames.t_ns, part.columns[Signal.HUB_SPEED].t_ns[-1]) for part in parts]
    ahead_ns = [part.watermark_ns - latest_ns[at] for part, at in zip(parts, behind, strict=True)]
    assert max(ahead_ns) <= LATE_NS
    assert (stage.counts.late, stage.counts.ignored) == (0, len(others))


def profile(**changes: BusSource | None) -> Profile:
    sources = {signal.value: source for signal, source in load_profile().sources.items()} | changes
    return Profile(name="test", sources={Signal(key): source for key, source in sources.items() if source is not None})


def test_everything_that_does_not_fit_is_listed() -> None:
    wrong = profile(
        current_gear=BusSource(message="TCU_Gears", signal="CurrentGear"),
        target_gear=BusSource(message="TCU_Shift", signal="NextGear"),
        odometer_m=BusSource(message="BRK_Vehicle", signal="VehicleSpeed"),
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
