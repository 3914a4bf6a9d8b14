"""``diag-service cluster``: the scheduler and the workers of a cluster, closed to all but who has a certificate."""

from types import SimpleNamespace

from diag_service.errors import ConfigError
from diag_service.lake.links import ClusterAddress
from diag_service.lake.nodes import run_scheduler, run_workers
from diag_service.service.stopping import Controls
from diag_service.settings.config import parse_listen_address
from fleet_link import AddressError, TlsFiles


def execute(options: SimpleNamespace, controls: Controls) -> None:
    """Run a part of a cluster until a signal comes."""
    tls = tls_files(options)
    if options.action == "scheduler":
        page = None if options.dashboard is None else parse_listen_address(options.dashboard)
        run_scheduler(options.host, options.port, tls, None if page is None else (page.host, page.port), controls.stop)
        return
    if options.jobs is not None and options.jobs < 1:
        raise ConfigError(f"--jobs must be at least 1, got {options.jobs}")
    address = ClusterAddress.parse(options.scheduler, tls)
    run_workers(address, options.host, options.jobs, options.memory, controls.stop)


def tls_files(options: SimpleNamespace) -> TlsFiles:
    """Return the certificates of the command line; raises ConfigError if one of a pair is missing."""
    try:
        return TlsFiles(authority=options.ca, certificate=options.cert, key=options.key)
    except AddressError as exc:
        raise ConfigError(str(exc)) from exc
