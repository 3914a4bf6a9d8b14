"""Bus faults on frames: what each kind does, exactly how often, and the same for any cutting of the stream."""

from collections.abc import Sequence

import numpy as np
import pytest

from canlog.e2e.profile1 import counter_of, crc_is_valid, data_id_remainder
from ecu_emulator.bus.bus_faults import BusFaults
from ecu_emulator.bus.frames import EncodedFrames, merge
from ecu_emulator.errors import EmulatorConfigError
from ecu_emulator.scenario.faults import BusFault, BusFaultKind, Phase
from ecu_emulator.sensing import MS_PER_S
from tests.support.wire import CONTRACTS, drive
from tests.unit.ecu_emulator.rows import made_up_rows
from tests.unit.ecu_emulator.sensing.test_sensor_faults import rows_with_shifts

MESSAGE = "TCU_Pressures"
CONTRACT = CONTRACTS[MESSAGE]
FRAMES = drive(0.9)
SEED = 5
START_S, DURATION_S = 0.3, 0.2  # twenty transmissions


def fault(kind: str, **changes: float | str) -> BusFault:
    given = {"kind": BusFaultKind(kind), "message": MESSAGE, "start_s": START_S, "duration_s": DURATION_S, **changes}
    return BusFault(**given)  # type: ignore[arg-type]


def struck(faults: Sequence[BusFault], chunk_ms: int = 900) -> tuple[EncodedFrames, tuple[int, ...]]:
    stage, rows, parts = BusFaults(faults, SEED, CONTRACTS), made_up_rows(900), []
    rows[:, :] = rows_with_shifts()
    for first_ms in range(0, len(rows), chunk_ms):
        own = rows[first_ms : first_ms + chunk_ms]
        end_s = (first_ms + len(own) - 1) / MS_PER_S
        inside = slice(*np.searchsorted(FRAMES.t_s, ((first_ms - 0.5) / MS_PER_S, end_s + 0.0005)).tolist())
        is_last = first_ms + chunk_ms >= len(rows)
        parts.append(stage.feed(FRAMES[inside], own, first_ms, end_s, is_last=is_last))
    for part in parts:
        assert np.all(np.diff(part.t_s) >= 0.0)
    return merge(parts), stage.counts


def of_message(frames: EncodedFrames, name: str = MESSAGE) -> EncodedFrames:
    rows = np.flatnonzero(frames.can_id == CONTRACTS[name].can_id)
    return EncodedFrames(
        t_s=frames.t_s[rows], can_id=frames.can_id[rows], length=frames.length[rows], data=frames.data[rows]
    )


def counters(frames: EncodedFrames) -> list[int]:
    return [int(counter) for counter in counter_of(frames.data)]


def has_sound_crcs(frames: EncodedFrames) -> bool:
    return bool(np.all(crc_is_valid(frames.data, data_id_remainder(CONTRACT.data_id or 0))))


BEFORE = of_message(FRAMES)
INSIDE = np.flatnonzero((BEFORE.t_s >= START_S) & (BEFORE.t_s < START_S + DURATION_S))


def test_a_restarted_sender_counts_from_zero() -> None:
    frames, (count,) = struck([fault("restart")])
    after = of_message(frames)
    assert len(BEFORE) - len(after) == 20
    assert counters(after)[INSIDE[0] :] == [number % 15 for number in range(len(after) - INSIDE[0])]
    assert has_sound_crcs(after)
    same_sender = [name for name, contract in CONTRACTS.items() if contract.sender == CONTRACT.sender]
    assert count == sum(len(of_message(FRAMES, name)) - len(of_message(frames, name)) for name in same_sender)
    assert np.array_equal(of_message(frames, "ECM_TorqueSpeed").data, of_message(FRAMES, "ECM_TorqueSpeed").data)


KINDS = [
    fault("loss", message="", share=0.3),
    fault("restart"),
    fault("duplicate", share=0.5),
    fault("reorder", share=0.3),
    fault("delay", jitter_s=0.05),
    fault("stuck_counter"),
    fault("spoof"),
    fault("error_frame", message=""),
    fault("overload", message="", share=0.8),
    fault("silence", shift=2, phase=Phase.TORQUE, start_s=0.01, duration_s=0.1),
]


@pytest.mark.parametrize("chunk_ms", [7, 100, 333])
def test_the_frames_do_not_depend_on_how_the_stream_was_cut(chunk_ms: int) -> None:
    whole, counts = struck(KINDS)
    cut, cut_counts = struck(KINDS, chunk_ms)
    assert cut_counts == counts
    assert np.array_equal(cut.t_s, whole.t_s)
    assert np.array_equal(cut.can_id, whole.can_id)
    assert np.array_equal(cut.data, whole.data)


@pytest.mark.parametrize(
    ("kind", "changes", "named"),
    [
        ("loss", {"share": 0.0}, "share must be above 0"),
        ("restart", {"share": 0.5}, "strikes all frames"),
        ("delay", {}, "needs one of them"),
        ("loss", {"delay_s": 0.1}, "belong to a fault of kind delay"),
        ("delay", {"delay_s": 11.0}, "delay_s must be"),
        ("skipping_counter", {}, "skip, 1..14"),
        ("loss", {"skip": 2}, "belongs to a fault of kind skipping_counter"),
        ("overload", {}, "no message"),
    ],
)
def test_what_does_not_belong_to_a_kind_is_refused(kind: str, changes: dict[str, float], named: str) -> None:
    with pytest.raises(EmulatorConfigError, match=named):
        fault(kind, **changes)
