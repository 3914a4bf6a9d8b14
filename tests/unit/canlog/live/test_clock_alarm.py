"""The alarm for a clock that is set: silent as long as nobody sets it; a guest's clock is set beside the vcan."""

import os

from canlog.live.bus_clock import ClockAlarm, clock_alarm


def test_an_alarm_is_silent_while_nobody_sets_the_clock() -> None:
    alarm = ClockAlarm()
    assert not alarm.acknowledge()
    os.fstat(alarm.fileno())
    alarm.close()
    alarm.close()
    assert alarm.fileno() == -1


def test_where_there_are_no_such_timers_there_is_no_alarm() -> None:
    assert clock_alarm(expiry_s=-1) is None  # refused, as an unknown kind of timer would be
