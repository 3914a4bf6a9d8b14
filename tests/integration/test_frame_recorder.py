"""Frames of a bus, kept one by one."""

import can
import pytest

from canlog.errors import SourceError
from canlog.live.medium import virtual
from canlog.live.recorder import FrameRecorder
from tests.support.patience import HANG_S


def test_frames_are_kept_in_their_order() -> None:
    bus = virtual("of a test")
    with bus.open() as near, bus.open() as far:
        with FrameRecorder(far) as recorder:
            for number in range(20):
                near.send(can.Message(arbitration_id=number, is_extended_id=False))
            assert len(recorder.wait_for(20, HANG_S)) == 20
            with pytest.raises(TimeoutError, match="20 frames, 21 were waited for"):
                recorder.wait_for(21, 0.0)
            near.send(can.Message(arbitration_id=20, is_extended_id=False))
            recorder.wait_until_quiet(0.1, HANG_S)
        assert [one.arbitration_id for one in recorder.messages] == list(range(21))
        near.send(can.Message(arbitration_id=21))
        assert far.recv(timeout=HANG_S) is not None  # it is still open, and nobody else reads it


def test_what_is_on_its_way_at_the_end_is_kept() -> None:
    bus = virtual("of a test")
    with bus.open() as near, bus.open() as far:
        for number in range(500):
            near.send(can.Message(arbitration_id=number))
        with FrameRecorder(far) as recorder:
            pass
        assert len(recorder.messages) == 500


def test_a_bus_that_never_falls_silent_is_told() -> None:
    bus = virtual("of a test")
    with bus.open() as far, FrameRecorder(far) as recorder, pytest.raises(TimeoutError, match="frames still come"):
        recorder.wait_until_quiet(HANG_S, 0.0)


def test_a_bus_that_fails_is_told() -> None:
    far = virtual("of a test").open()
    with FrameRecorder(far) as recorder:
        far.shutdown()
        with pytest.raises(SourceError, match="cannot be read"):
            recorder.wait_for(1, HANG_S)
