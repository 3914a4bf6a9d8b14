"""Wiring that buses and logs share: a checked configuration becomes a store and an outbox."""

import asyncio
import logging
import uuid
from collections.abc import Coroutine, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager
from contextvars import copy_context
from dataclasses import asdict, replace
from importlib.metadata import version
from pathlib import Path
from typing import Final, TypeVar

from canlog.files import is_there
from clutch_results.records import ServiceStatus, status_record
from clutchdiag_io.program import legible
from diag_service import delivery
from diag_service.delivery.outbox import MetricsMessage
from diag_service.errors import StoreError
from diag_service.service.session import Session, utc_now, versions_for
from diag_service.settings.config import DiagnosisConfig
from diag_service.store import ResultStore, remove_store
from fleet_contract import NEVER, Outgoing, config_message, metrics_message, status_message

MOST_TYPE_NAME: Final = 128  # characters, as the contract has it
_LOG = logging.getLogger(__name__)


@contextmanager
def opened_store(config: DiagnosisConfig, path: Path | None, *, keeps_results: bool) -> Iterator[ResultStore]:
    """Open a store, None: one in memory. A run that fails leaves none behind that it began, unless it holds results."""
    new = path if path is not None and not is_there(path) else None
    with closing(ResultStore.open(path, config.budget_bytes)) as store:
        try:
            yield store
        except BaseException as exc:
            is_worth_keeping = keeps_results or isinstance(exc, StoreError)
            if new is not None and not (is_worth_keeping and store.holds_results):
                remove_store(new)  # before it is closed: nobody else has it yet
            raise


def outbox_of(
    config: DiagnosisConfig, store: ResultStore, session: Session, *, is_live: bool
) -> delivery.Outbox | None:
    """Return the outbox that sends results to the broker; None without a broker."""
    if config.broker is None:
        return None
    if danger := config.broker.exposure:
        _LOG.warning("%s", danger)
    versions = versions_for(config.calibration)
    status = ServiceStatus(
        vehicle=config.vehicle,
        is_online=True,
        connected_at=utc_now(),
        service_version=version("clutchdiag"),
        algorithm_version=versions.algorithm,
        calibration_version=versions.calibration,
        calibration={
            "vehicle_type": " ".join(legible(config.calibration.name).split())[:MOST_TYPE_NAME] or "unnamed",
            "new_friction": [asdict(clutch.friction) for clutch in config.calibration.clutches],
        },
    )
    farewell = status_message(status_record(replace(status, is_online=False, connected_at=NEVER)))
    connector = delivery.MqttConnector(
        config.broker,
        f"clutchdiag-{config.vehicle}-{_secret_of(store)}" if is_live else f"clutchdiag-{uuid.uuid4()}",
        status if is_live else None,
        is_persistent=is_live and config.acknowledge is delivery.Acknowledge.BACKEND,
    )
    return delivery.Outbox(
        store,
        config.vehicle,
        lambda: connector.connect(utc_now()),
        str(config.broker),
        acknowledge=config.acknowledge,
        greetings=[_greeting(config, status) if is_live else replace(farewell, is_retained=False)],
        holds_states=not is_live,
        metrics=_metrics_of(store, session) if is_live else None,
    )


def _secret_of(store: ResultStore) -> str:
    """Return the random part of our client identifier: whoever connects by the same one ends our connection."""
    try:
        return store.connection_secret()
    except StoreError as exc:
        _LOG.warning("the broker knows us by a new name until the next start: %s", exc)
        return uuid.uuid4().hex


def _greeting(config: DiagnosisConfig, status: ServiceStatus) -> Outgoing:
    """Return the message with which a live service announces its settings; it holds no secret."""
    settings: dict[str, str | float | bool | None] = {
        **{f"{name}_version": getattr(status, f"{name}_version") for name in ("service", "algorithm", "calibration")},
        "broker": str(config.broker),
        "broker_is_encrypted": config.broker is not None and config.broker.tls is not None,
        "acknowledge": config.acknowledge.value,
        "store_budget_bytes": config.budget_bytes,
        "dbc": legible(str(config.dbc or "shipped")),
        "profile": legible(str(config.profile or "shipped")),
    }
    return config_message(config.vehicle, utc_now(), settings)


def _metrics_of(store: ResultStore, session: Session) -> MetricsMessage:
    def message(numbers: Mapping[str, float]) -> Outgoing:
        counts = {
            "store_used_bytes": store.used_bytes(),
            **{f"store_dropped_{name}_count": count for name, count in store.dropped_counts().items()},
            "store_given_up_count": session.given_up_count,
        }
        return metrics_message(session.vehicle, utc_now(), {**numbers, **counts})

    return message


ResultT = TypeVar("ResultT")


def first_error(group: BaseExceptionGroup[BaseException]) -> BaseException:
    """Return the error that ended a task group; what it caused in other tasks came after it."""
    first = group.exceptions[0]
    return first_error(first) if isinstance(first, BaseExceptionGroup) else first


def run_to_end(work: Coroutine[None, None, ResultT]) -> ResultT:
    """Run a coroutine in a loop of its own; where the caller has one that runs, as in a notebook, in another thread."""
    try:
        asyncio.get_running_loop()
    except RuntimeError:
        return asyncio.run(work)
    with ThreadPoolExecutor(1, "own loop") as thread:
        return thread.submit(copy_context().run, asyncio.run, work).result()
