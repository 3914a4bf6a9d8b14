"""Signals are kept until somebody listens."""

import signal

from diag_service.service.stopping import PatientTrigger, Trigger


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


def test_a_patient_trigger_waits_for_the_writer_of_a_pipe() -> None:
    now_s = [10.0]
    first = Trigger()
    patient = PatientTrigger(first, patience_s=1.0, now_s=lambda: now_s[0])
    assert not patient.is_set
    first.set()
    first.set()  # the same Ctrl-C, from the terminal and from a wrapper
    now_s[0] = 10.9
    assert not patient.is_set
    now_s[0] = 11.0
    assert patient.is_set
