"""Prometheus metrics and health checks of a live run over HTTP, in threads of their own."""

import logging
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from datetime import datetime
from http import HTTPStatus
from typing import Any, Final
from wsgiref.simple_server import WSGIRequestHandler
from wsgiref.types import StartResponse, WSGIEnvironment

from prometheus_client import CollectorRegistry, make_wsgi_app, start_wsgi_server
from prometheus_client.core import Metric

from canlog.e2e.e2e_state import E2eState
from canlog.live import BusState
from clutch_results.loads import ENERGY_BOUNDS_J
from clutch_results.records import Condition, ShiftResult, Status
from clutchdiag_io.metrics import Told, counter, gauge, histogram
from diag_service.diagnosis.summary import newest_causes
from diag_service.errors import ConfigError
from diag_service.service.session import Stage
from diag_service.service.snapshot import Board, Snapshot
from diag_service.settings.config import ListenAddress
from fleet_contract import CLUTCHES

CLIENT_TIMEOUT_S: Final = 5.0
_LOG = logging.getLogger(__name__)
_CLUTCH_LABELS: Final = ("vehicle", "clutch")
_COEFFICIENTS: Final = ("mu_c", "mu_s")  # a label: as parts of names "_c" and "_s" would read as units
_OF_ESTIMATES: Final = (  # name of the metric, part of the verdict, its field with the coefficient for the braces, help
    ("level_ratio", "", "level_ratio", "Friction at high slip over that of new fluid."),
    ("estimate_shifts", "", "shift_count", "Shifts in the running estimate."),
    ("negative_slope_probability_ratio", "friction", "probability_negative_slope", "P that friction falls with slip."),
    ("mu", "friction", "{}", "Friction coefficient at high (mu_c) and low (mu_s) slip, running estimate."),
    ("mu_std", "friction", "std_{}", "Standard deviation of the friction coefficient, common scale included."),
    ("mu_change_ratio", "trend", "change_{}_ratio", "Change since the baseline of this fluid."),
    ("mu_change_std_ratio", "trend", "std_change_{}_ratio", "Standard deviation of that change."),
)
_OF_LOADS: Final = (
    (counter, "clutch_launches", "launch_count", "Launches of this run."),
    (counter, "clutch_life_ratio", "life_ratio", "Share of a lining's life that this slip consumes, as an index."),
    (gauge, "clutch_peak_temperature_kelvin", "peak_k", "Highest temperature of the pack in this run."),
)


def families(snapshot: Snapshot) -> Iterator[Metric]:
    """Yield all families of a snapshot; what is not known has no sample."""
    yield from _of_the_bus(snapshot)
    yield from _of_messages(snapshot)
    yield from _of_shifts(snapshot)
    yield from _of_clutches(snapshot)
    yield from _of_the_estimates(snapshot)


def _of_the_bus(snapshot: Snapshot) -> Iterator[Metric]:
    bus, frames = snapshot.bus, snapshot.summary.frames
    fates = {
        "decoded": frames.decoded,
        "ignored": frames.ignored,
        "unsupported": frames.unsupported,
        "kernel_dropped": frames.kernel_dropped,
        "queue_dropped": frames.queue_dropped,
        **{f"rejected_{reason}": count for reason, count in frames.rejected.items()},
    }
    yield gauge("bus_state", "1 for the state that the bus is in.", _one_of(BusState, bus.state), "state")
    yield gauge("bus_load_ratio", "Share of the bit rate, stuff bits estimated.", snapshot.load_ratio)
    yield counter("bus_errors", "Error frames by what they tell.", dict(bus.errors), "kind")
    yield counter("bus_interruptions", "Times that the interface was lost.", bus.interruption_count)
    yield counter("bus_restarts_asked", "Restarts asked of the controller.", bus.restart_count)
    yield counter("clock_steps", "Steps of the wall clock.", snapshot.clock_steps)
    yield counter("frames_on_bus", "Frames that reached this machine.", frames.on_bus)
    yield counter("frames", "Frames by what became of them.", fates, "fate")
    yield counter("frames_missing", "Frames that alive counters show to be lost.", frames.missing)


def _of_messages(snapshot: Snapshot) -> Iterator[Metric]:
    messages = snapshot.messages.items()
    nominal = {name: message.nominal_hz for name, message in messages if message.nominal_hz is not None}
    states = {
        (name, state): value
        for name, message in messages
        for state, value in _one_of(E2eState, message.e2e_state).items()
    }
    lapses = {name: message.invalidations for name, message in messages}
    yield gauge("message_rate_hertz", "Frames per second, as received.", snapshot.rates_hz, "message")
    yield gauge("message_nominal_hertz", "Frames per second, as the database says.", nominal, "message")
    yield gauge("message_e2e_state", "1 for the E2E state of the message.", states, "message", "state")
    yield counter("message_invalidations", "Times that a message lost its trust.", lapses, "message")


def _of_shifts(snapshot: Snapshot) -> Iterator[Metric]:
    summary, stuck = snapshot.summary, {stage.value: 0.0 for stage in Stage}
    if snapshot.stuck is not None:
        stuck[snapshot.stuck.stage.value] = snapshot.stuck.for_s
    yield gauge("stage_stuck_seconds", "How long a stage has held work without progress.", stuck, "stage")
    yield counter("shifts", "Shifts by what their estimate is worth.", summary.shifts.by_status, "status")
    yield counter("shift_reasons", "Shifts that were not used, by reason.", summary.shifts.by_reason, "reason")
    qualities = [result.estimate.data_quality for result in snapshot.recent if result.estimate.data_quality is not None]
    if qualities:
        yield gauge("last_shift_trust", "Trust in the last shift, 0..1.", qualities[-1].score)
    scored = [result.estimate.shift_quality for result in snapshot.recent]
    scores = [quality.score for quality in scored if quality is not None and quality.score is not None]
    last: Mapping[tuple[str, ...], float] = {(): scores[-1]} if scores else {}
    yield gauge("last_shift_score", "How well the last gear change went, 0..100.", last)


def _of_clutches(snapshot: Snapshot) -> Iterator[Metric]:
    """Yield the families of each clutch; one that never engaged has no verdict."""
    vehicle, by_clutch = snapshot.summary.vehicle, snapshot.summary.shifts.by_clutch
    elements = {result.verdict.clutch: result.verdict.element for result in snapshot.clutches if result.verdict.element}
    names = elements or {clutch: str(clutch) for clutch in CLUTCHES}
    verdicts = {result.verdict.clutch: result.verdict.condition for result in snapshot.clutches}
    states = {
        (vehicle, name, word): value
        for clutch, name in names.items()
        for word, value in _one_of(Condition, verdicts.get(clutch, Condition.NO_VERDICT)).items()
    }
    counts = {
        (vehicle, name, status.value): by_clutch.get((clutch, status.value), 0)
        for clutch, name in names.items()
        for status in Status
    }
    yield gauge("clutch_verdict", "1 for the verdict on the clutch and its fluid.", states, *_CLUTCH_LABELS, "verdict")
    orders = {(*_key(result), snapshot.summary.order.text): 1.0 for result in snapshot.clutches}
    yield gauge("clutch_advice_info", "What the vehicle is told; the same for both.", orders, *_CLUTCH_LABELS, "advice")
    causes = newest_causes(snapshot.clutches, snapshot.summary.today_ns)
    likely = (
        {}
        if causes is None
        else {(vehicle, cause.cause, str(cause.clutch or "")): cause.probability for cause in causes.likely}
    )
    yield gauge("cause_probability", "That this is wrong, alone or with another.", likely, "vehicle", "cause", "clutch")
    yield counter(
        "clutch_shifts", "Shifts of this run by what their estimate is worth.", counts, *_CLUTCH_LABELS, "status"
    )
    made = {_key(result): datetime.fromisoformat(result.produced_at).timestamp() for result in snapshot.clutches}
    yield gauge("clutch_last_result_timestamp_seconds", "When the last result was made.", made, *_CLUTCH_LABELS)
    loads = {(vehicle, names.get(clutch, str(clutch))): load for clutch, load in snapshot.summary.loads.items()}
    energies = {key: (load.counts, load.energy_j) for key, load in loads.items()}
    text = "Slip energy of the events of this run."
    yield histogram("clutch_slip_energy_joules", text, ENERGY_BOUNDS_J, energies, *_CLUTCH_LABELS)
    for make, name, field, text in _OF_LOADS:
        known = {key: getattr(load, field) for key, load in loads.items() if getattr(load, field) is not None}
        yield make(name, text, known, *_CLUTCH_LABELS)
    filled = {} if snapshot.fluid is None else {vehicle: datetime.fromisoformat(snapshot.fluid.filled_at).timestamp()}
    yield gauge("fluid_fill_timestamp_seconds", "When the present fluid was filled in.", filled, "vehicle")


def _of_the_estimates(snapshot: Snapshot) -> Iterator[Metric]:
    """Yield the numbers behind the verdicts."""
    verdicts = {_key(result): result.verdict for result in snapshot.clutches}
    for name, part, field, text in _OF_ESTIMATES:
        records = {key: getattr(verdict, part) if part else verdict for key, verdict in verdicts.items()}
        labels = [(symbol,) for symbol in _COEFFICIENTS] if "{}" in field else [()]
        values = {
            (*key, *label): getattr(record, field.format(*label))
            for key, record in records.items()
            for label in labels
            if record is not None
        }
        known = {key: value for key, value in values.items() if value is not None}
        yield gauge(f"clutch_{name}", text, known, *_CLUTCH_LABELS, *(["coefficient"] if labels[0] else []))


def _key(result: ShiftResult) -> tuple[str, str]:
    return result.vehicle, result.verdict.element or str(result.verdict.clutch)


def _one_of(states: Any, present: Any) -> dict[str, float]:  # noqa: ANN401 - any enumeration
    return {state.name.lower(): float(state is present) for state in states}


class _Handler(WSGIRequestHandler):
    """A handler that logs requests at level DEBUG only."""

    timeout = CLIENT_TIMEOUT_S

    def log_message(self, format: str, *args: object) -> None:  # noqa: A002 - the name that the library gave it
        _LOG.debug(format, *args)


@contextmanager
def serving(address: ListenAddress, board: Board) -> Iterator[int]:
    """Serve ``/metrics``, ``/livez``, ``/readyz`` while entered; yield the port. Raises ConfigError where it cannot."""
    registry = CollectorRegistry()
    registry.register(Told(lambda: () if board.latest is None else families(board.latest)))  # none before the first
    metrics = make_wsgi_app(registry)
    checks = {"/livez": lambda: board.is_live, "/readyz": lambda: board.is_ready}

    def answer(environ: WSGIEnvironment, start_response: StartResponse) -> Iterable[bytes]:
        path = environ.get("PATH_INFO", "")
        if path == "/metrics":
            body: Iterable[bytes] = metrics(environ, start_response)
            return body
        check = checks.get(path)
        status = HTTPStatus.NOT_FOUND
        if check is not None:
            status = HTTPStatus.OK if check() else HTTPStatus.SERVICE_UNAVAILABLE
        start_response(f"{status.value} {status.phrase}", [("Content-Type", "text/plain; charset=utf-8")])
        return [f"{status.phrase}\n".encode()]

    try:
        server, thread = start_wsgi_server(address.port, address.host, registry)  # a client that stalls holds up nobody
    except OSError as exc:
        raise ConfigError(f"cannot serve metrics on {address.host}:{address.port}: {exc.strerror or exc}") from exc
    server.RequestHandlerClass = _Handler
    server.set_app(answer)
    try:
        yield server.server_port
    finally:
        server.shutdown()
        server.server_close()
        thread.join()
