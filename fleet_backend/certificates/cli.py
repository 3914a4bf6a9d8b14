"""Command line: ``fleet-certificates init|server|client|node|access``; the same command renews."""

from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from types import SimpleNamespace
from typing import Final

import click

from clutchdiag_io.command_line import FILE, FLOAT, Command, Option, Program
from clutchdiag_io.program import complain
from fleet_backend.errors import CertificateError

PROGRAM: Final = "fleet-certificates"
EXIT_OK, EXIT_USAGE = 0, 2
_EXIT_TEXT: Final = "exit status: 0 done, 1 unexpected error, 2 usage, or an extra that is not installed"
_FOLDER: Final = Option("--folder FOLDER", "default: certificates", FILE, default=Path("certificates"))


def _days(default: float) -> Option:
    return Option("--days DAYS", f"until it expires (default: {default:g})", FLOAT, default=default)


COMMAND_LINE: Final = Program(
    PROGRAM,
    "Makes and renews certificates of a test authority, for trials: its key lies in the same folder. A certificate "
    "that exists is replaced, whole; running services take the new one by themselves.",
    _EXIT_TEXT,
    Command("init", "make an authority", _FOLDER, _days(3650.0), examples=(f"{PROGRAM} init --folder fleet",)),
    Command(
        "server",
        "make or renew the certificate of a broker",
        click.Argument(["name"], help="name of the files"),
        Option("--host HOST", "name or address of the broker; may be repeated", multiple=True),
        *(_FOLDER, _days(398.0)),
        examples=(f"{PROGRAM} server broker --host broker.example --host 192.0.2.7 --folder fleet",),
    ),
    Command(
        "client",
        "make or renew the certificate of a vehicle or a backend",
        click.Argument(["name"], help="vehicle id, or the name of the backend: the common name of the certificate"),
        *(_FOLDER, _days(90.0)),
        examples=(f"{PROGRAM} client car1 --folder fleet",),
    ),
    Command(
        "node",
        "make or renew the certificate of a part of a cluster that analyses logs",
        click.Argument(["name"], help="name of the files"),
        Option("--host HOST", "name or address of the machine; may be repeated", multiple=True),
        *(_FOLDER, _days(90.0)),
        examples=(f"{PROGRAM} node node1 --host node1.example --folder fleet",),
    ),
    Command(
        "access",
        "write what each client may say and hear: dynamic-security.json for Mosquitto, nats-users.conf for nats-server",
        _FOLDER,
        examples=(f"{PROGRAM} access --folder fleet",),
    ),
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Make what is asked for and return the exit status."""
    options = COMMAND_LINE.parse(arguments)
    try:
        _execute(options)
    except Exception as exc:  # noqa: BLE001 - the one place where nothing may pass
        return complain(PROGRAM, exc, [(CertificateError, EXIT_USAGE)])
    return EXIT_OK


def _execute(options: SimpleNamespace) -> None:
    try:
        from fleet_backend.certificates.access import write_access  # noqa: PLC0415 - needs the extra
        from fleet_backend.certificates.authority import Authority, Lifetime  # noqa: PLC0415
    except ModuleNotFoundError as exc:
        if exc.name is None or exc.name.startswith("fleet_backend.certificates"):
            raise
        raise CertificateError(f"{exc.name} is not installed: pip install '.[security]' in the checkout") from exc
    if options.command == "access":
        write_access(options.folder)
        return
    lifetime = Lifetime.of_days(options.days, datetime.now(UTC))
    if options.command == "init":
        Authority.make(options.folder, lifetime)
    elif options.command == "server":
        Authority.open(options.folder).issue_server(options.name, options.host, lifetime)
    elif options.command == "node":
        Authority.open(options.folder).issue_node(options.name, options.host, lifetime)
    else:
        Authority.open(options.folder).issue_client(options.name, lifetime)
