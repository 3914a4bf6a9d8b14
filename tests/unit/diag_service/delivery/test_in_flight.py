"""What a backend owes receipts for: lost on the way is told from a backend that is behind."""

from diag_service.delivery.delivery import InFlight

ASTRAY_AFTER_S = 2.0


def test_nothing_owed_is_nothing_late() -> None:
    in_flight = InFlight(ASTRAY_AFTER_S)
    assert (len(in_flight), in_flight.oldest_s(), in_flight.lag_s(9.0)) == (0, None, 0.0)
    assert in_flight.pop_astray() == in_flight.pop_sent_until(9.0) == []


def test_a_silent_backend_is_behind_and_nothing_is_astray() -> None:
    in_flight = InFlight(ASTRAY_AFTER_S)
    in_flight.add([1, 2], 10.0)
    in_flight.add([3], 11.0)
    assert in_flight.lag_s(15.0) == 5.0
    assert in_flight.pop_astray() == []
    assert in_flight.pop_oldest(1) == [1]
    assert in_flight.pop_sent_until(10.5) == [2]
    assert (len(in_flight), in_flight.oldest_s()) == (1, 11.0)


def test_a_receipt_for_a_younger_result_tells_what_went_astray() -> None:
    in_flight = InFlight(ASTRAY_AFTER_S)
    in_flight.add([1, 2], 10.0)
    in_flight.add([3], 11.0)
    in_flight.add([4], 13.0)
    in_flight.acknowledge([4])
    assert in_flight.lag_s(13.5) == 0.0  # the backend is not behind
    assert in_flight.pop_astray() == [1, 2, 3]
    assert len(in_flight) == 0


def test_what_was_sent_again_early_waits_its_full_time_then() -> None:
    in_flight = InFlight(ASTRAY_AFTER_S)
    in_flight.add([1], 10.0)
    in_flight.add([2], 13.0)
    in_flight.acknowledge([2])
    assert in_flight.pop_astray() == [1]
    in_flight.add([1], 13.1)
    in_flight.add([3], 16.0)
    in_flight.acknowledge([3])
    assert in_flight.pop_astray() == []
    assert in_flight.pop_sent_until(13.1) == [1]


def test_workers_of_different_speed_are_waited_for() -> None:
    in_flight = InFlight(ASTRAY_AFTER_S)
    in_flight.add([1], 10.0)
    in_flight.add([2], 11.9)
    in_flight.acknowledge([2])
    assert in_flight.pop_astray() == []
    in_flight.acknowledge([1])
    assert len(in_flight) == 0


def test_a_receipt_for_what_nobody_owes_changes_nothing() -> None:
    in_flight = InFlight(ASTRAY_AFTER_S)
    in_flight.add([1], 10.0)
    in_flight.acknowledge([7])
    assert in_flight.lag_s(12.0) == 2.0
