"""Messages that no backend can use."""

import json
from typing import Final

from clutch_results.records import shift_record
from fleet_contract import shift_message
from tests.support.fleet import fleet_result

_KINDS: Final = 8


def poison_messages(count: int) -> list[tuple[str, bytes]]:
    """Return messages that no backend can use, of every kind in turn, no two alike."""
    good = json.loads(shift_message(shift_record(fleet_result(1))).payload)
    kinds = (
        lambda number: ("clutchdiag/v1/car9/shift", b"{" * 40 + str(number).encode()),
        lambda number: ("clutchdiag/v1/car9/shift", b'{"a":' * 5000 + str(number).encode()),
        lambda number: ("clutchdiag/v1/car9/shift", str(number).encode() * 20_000),
        lambda number: ("clutchdiag/v1/car9/shift", b"\xff" + number.to_bytes(4)),
        lambda number: ("clutchdiag/v1/car9/shift", _changed(good, seq=number, quality=-1.0)),
        lambda number: ("clutchdiag/v1/car9/shift", _changed(good, seq=number)),  # of car1, as it says
        lambda number: ("clutchdiag/v1/car9/status", f'{{"specversion":"{number}"}}'.encode()),
        lambda number: ("clutchdiag/v1/.bad/shift", str(number).encode()),
    )
    assert len(kinds) == _KINDS
    return [kinds[number % _KINDS](number + 1) for number in range(count)]


def _changed(event: dict[str, object], **data: object) -> bytes:
    old = event["data"]
    assert isinstance(old, dict)
    return json.dumps({**event, "data": {**old, **data}}).encode()
