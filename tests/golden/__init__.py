"""Messages of each version of the fleet contract, byte by byte as the code wrote them when the version began."""

from pathlib import Path

from clutch_results.records import ServiceStatus, clutch_record, shift_record, status_record
from fleet_contract import (
    JsonObject,
    Outcome,
    Outgoing,
    Receipt,
    ack_messages,
    clutch_message,
    config_message,
    controller_message,
    fluid_message,
    key_of,
    metrics_message,
    shift_message,
    status_message,
)
from tests.support.builders import rejected, shift_result
from workshop.tester.polling import ControllerReport
from workshop.tester.trouble import FailureRecord, TroubleCode

FOLDER = Path(__file__).parent
NOW = "2026-01-01T00:00:06.000000Z"

CONTROLLER = ControllerReport(
    vehicle="car1",
    read_at=NOW,
    controller="7E1 (answers 7E9)",
    description="TCU",
    codes=(
        TroubleCode(
            number=0x089700,
            status=0x2F,
            text="Transmission Fluid Deteriorated",
            snapshots=(FailureRecord(number=1, data={"odometer": {"distance [km]": 12.5, "trip [km]": None}}),),
            extended=(FailureRecord(number=16, data={}, rest=b"\x01\x02"),),
        ),
    ),
)


def messages_v1() -> dict[str, Outgoing]:
    """Return the messages that today's code makes, by the name of their file."""
    shift, refused = shift_record(shift_result()), shift_record(rejected(shift_result(2)))
    receipts = [
        Receipt(key=key_of(shift)),
        Receipt(key=key_of(refused), outcome=Outcome.QUARANTINED, reason="sump_temperature_k: must be number"),
    ]
    fills: list[JsonObject] = [
        {"filled_at": "2026-01-01T00:00:03.000000Z", "odometer_m": 1200.5, "product": "DCTF-II", "note": "workshop"},
        {"filled_at": "2026-01-01T00:00:05.000000Z", "odometer_m": None, "product": None, "note": None},
    ]
    (ack,) = ack_messages("car1", receipts, sent_at=NOW, worker="ingest-1")
    return {
        "shift": shift_message(shift),
        "shift-rejected": shift_message(refused),
        "clutch": clutch_message(clutch_record(shift_record(shift_result()))),
        "clutch-unknown": clutch_message(clutch_record(shift_record(rejected(shift_result())))),
        "status-online": status_message(status_record(_status(is_online=True))),
        "status-offline": status_message(status_record(_status(is_online=False))),
        "metrics": metrics_message("car1", NOW, {"outbox_waiting_count": 3, "outbox_bytes": 81920, "load_ratio": 0.25}),
        "config": config_message("car1", NOW, {"broker.url": "mqtts://car1:***@broker", "outbox.budget_bytes": 1}),
        "controller": controller_message(CONTROLLER.record),
        "ack": ack,
        "fluid": fluid_message("car1", NOW, fills, is_to_vehicle=False),
        "fills": fluid_message("car1", NOW, fills, is_to_vehicle=True),
    }


def _status(*, is_online: bool) -> ServiceStatus:
    return ServiceStatus(
        vehicle="car1",
        is_online=is_online,
        connected_at="2026-01-01T00:00:00.000000Z",
        service_version="0.1.0",
        algorithm_version="algorithm-1",
        calibration_version="1+0123456789ab",
    )
