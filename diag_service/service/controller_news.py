"""What a controller says goes where results go: into the store, to whoever watches, to the broker."""

from collections.abc import Callable, Mapping
from typing import Final

from diag_service.delivery import Reporter
from diag_service.diagnosis.results import dump
from diag_service.store import ResultStore
from diag_service.tester.trouble_report import ControllerReport, controller_record
from fleet_contract import Channel, Outgoing, controller_message

MOST_CODES: Final = 1024  # as the contract has it
_KEPT: Final = ("snapshots", "extended_data")


def tell_controller(
    report: ControllerReport, store: ResultStore, reporter: Reporter, publish: Callable[[Outgoing], object]
) -> None:
    """Store what a controller said and tell it, if it is something new; raises StoreFullError, StoreError.

    What is new to this run is published in any case: a broker may have forgotten it.
    """
    record = controller_record(report)
    said = dump({key: value for key, value in record.items() if key != "produced_at"})
    is_new = store.note_controller(report.vehicle, report.controller, said, dump(record))
    publish(message_of(record))
    if is_new:
        reporter.report(report)


def message_of(record: Mapping[str, object]) -> Outgoing:
    """Return the message of a record; one that would be too long for the contract goes without what was kept."""
    told = record["codes"]
    codes = told[:MOST_CODES] if isinstance(told, list) else []
    message = controller_message({**record, "codes": codes})
    if len(message.payload) <= Channel.CONTROLLER.max_bytes:
        return message
    short = [{**code, **{name: [] for name in _KEPT}} for code in codes]
    return controller_message({**record, "codes": short[: _most(short)]})


def _most(codes: list[dict[str, object]]) -> int:
    """Return how many codes without what was kept fit into a message."""
    longest = max((len(dump(code)) for code in codes), default=1) + 1
    return int((Channel.CONTROLLER.max_bytes - 2048) // longest)
