"""What a backend owes receipts for: lost on the way is told from a backend that is behind."""

from diag_service.delivery.owed import Owed

ASTRAY_AFTER_S = 2.0


def test_nothing_owed_is_nothing_late() -> None:
    owed = Owed(ASTRAY_AFTER_S)
    assert (len(owed), owed.oldest_s(), owed.lag_s(9.0)) == (0, None, 0.0)
    assert owed.take_astray() == owed.take_sent_until(9.0) == []


def test_a_silent_backend_is_behind_and_nothing_is_astray() -> None:
    owed = Owed(ASTRAY_AFTER_S)
    owed.send([1, 2], 10.0)
    owed.send([3], 11.0)
    assert owed.lag_s(15.0) == 5.0
    assert owed.take_astray() == []
    assert owed.take_oldest(1) == [1]
    assert owed.take_sent_until(10.5) == [2]
    assert (len(owed), owed.oldest_s()) == (1, 11.0)


def test_a_receipt_for_a_younger_result_tells_what_went_astray() -> None:
    owed = Owed(ASTRAY_AFTER_S)
    owed.send([1, 2], 10.0)
    owed.send([3], 11.0)
    owed.send([4], 13.0)
    owed.hear([4])
    assert owed.lag_s(13.5) == 0.0  # the backend is not behind
    assert owed.take_astray() == [1, 2, 3]
    assert len(owed) == 0


def test_what_was_sent_again_early_waits_its_full_time_then() -> None:
    owed = Owed(ASTRAY_AFTER_S)
    owed.send([1], 10.0)
    owed.send([2], 13.0)
    owed.hear([2])
    assert owed.take_astray() == [1]
    owed.send([1], 13.1)
    owed.send([3], 16.0)
    owed.hear([3])
    assert owed.take_astray() == []
    assert owed.take_sent_until(13.1) == [1]


def test_workers_of_different_speed_are_waited_for() -> None:
    owed = Owed(ASTRAY_AFTER_S)
    owed.send([1], 10.0)
    owed.send([2], 11.9)
    owed.hear([2])
    assert owed.take_astray() == []
    owed.hear([1])
    assert len(owed) == 0


def test_a_receipt_for_what_nobody_owes_changes_nothing() -> None:
    owed = Owed(ASTRAY_AFTER_S)
    owed.send([1], 10.0)
    owed.hear([7])
    assert owed.lag_s(12.0) == 2.0
