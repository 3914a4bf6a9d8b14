"""The state of a bus: what is heard moves it, and trouble is forgotten."""

from canlog.frames import ERROR_FLAG, BusTrouble, FrameBatch
from canlog.live.supervisor import TROUBLE_S, BusState, BusWatch
from tests.support.batches import frames_at

DATA, BUS_OFF, RESTART, ARBITRATION = 0x123, ERROR_FLAG | 0x40, ERROR_FLAG | 0x100, ERROR_FLAG | 0x2


def heard(*can_ids: int) -> FrameBatch:
    return frames_at(range(len(can_ids)), can_ids)


def test_an_error_degrades_the_bus_for_a_while() -> None:
    watch = BusWatch()
    watch.add_frames(heard(DATA, ARBITRATION, DATA), 0, 10.0)
    assert watch.status(10.0 + 0.9 * TROUBLE_S).state is BusState.DEGRADED
    assert watch.status(10.0 + TROUBLE_S).state is BusState.UP
    assert watch.status(99.0).errors == {BusTrouble.ARBITRATION_LOST: 1}


def test_bus_off_lasts_until_a_restart_and_that_until_a_frame() -> None:
    watch = BusWatch()
    states = []
    for batch in (heard(DATA, BUS_OFF), heard(ARBITRATION), heard(RESTART), heard(DATA)):
        watch.add_frames(batch, 0, 0.0)
        states.append(watch.status(2 * TROUBLE_S).state)
    assert states == [BusState.BUS_OFF, BusState.BUS_OFF, BusState.RESTARTED, BusState.UP]
    assert watch.status(0.0).last_problem == "the controller went bus-off"


def test_an_interface_that_goes_and_comes() -> None:
    watch = BusWatch()
    watch.mark_lost("gone")
    assert watch.status(0.0).state is BusState.DOWN
    watch.mark_back()
    assert watch.status(0.0).state is BusState.RESTARTED
    watch.add_frames(heard(DATA), 0, 1.0)
    status = watch.status(1.0)
    assert (status.state, status.interruption_count, status.last_problem) == (BusState.UP, 1, "gone")
