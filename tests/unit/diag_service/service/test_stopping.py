"""Signals are kept until somebody listens."""

import signal

from diag_service.service.stopping import Trigger


def test_who_comes_late_hears_of_it_at_once() -> None:
    trigger, heard = Trigger(), list[str]()
    trigger.set()
    trigger.subscribe(lambda: heard.append("late"))
    assert heard == ["late"]


def test_every_setting_is_told_until_the_listener_leaves() -> None:
    trigger, heard = Trigger(), list[str]()

    def listen() -> None:
        heard.append("now")

    trigger.subscribe(listen)
    assert not heard
    trigger.set()
    trigger.set()
    trigger.unsubscribe(listen)
    trigger.set()
    assert heard == ["now", "now"]


def test_a_signal_sets_the_trigger_instead_of_ending_the_process() -> None:
    before = signal.getsignal(signal.SIGUSR2)
    trigger = Trigger()
    try:
        trigger.listen_to(signal.SIGUSR2)
        signal.raise_signal(signal.SIGUSR2)
    finally:
        signal.signal(signal.SIGUSR2, before)
    assert trigger.is_set
