"""Command line: ``fleet-certificates init|server|client``; the same command renews."""

import argparse
import sys
from collections.abc import Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Final

from fleet_certificates.authority import Authority, Lifetime
from fleet_certificates.errors import CertificateError

PROGRAM: Final = "fleet-certificates"
EXIT_OK, EXIT_USAGE = 0, 2
_DAYS: Final = {"init": 3650.0, "server": 398.0, "client": 90.0}


def main(arguments: Sequence[str] | None = None) -> int:
    """Make what is asked for and return the exit status: 0 done, 2 not possible."""
    options = _parser().parse_args(arguments)
    lifetime = Lifetime.of_days(options.days, datetime.now(UTC))
    try:
        if options.command == "init":
            Authority.make(options.folder, lifetime)
        elif options.command == "server":
            Authority.open(options.folder).issue_server(options.name, options.host, lifetime)
        else:
            Authority.open(options.folder).issue_client(options.name, lifetime)
    except CertificateError as exc:
        sys.stderr.write(f"{PROGRAM}: error: {exc}\n")
        return EXIT_USAGE
    return EXIT_OK


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog=PROGRAM,
        description="Makes and renews certificates of a test authority, for trials: its key lies in the same folder. "
        "A certificate that exists is replaced, whole; running services take the new one by themselves.",
    )
    parser.add_argument("--version", action="version", version=f"{PROGRAM} {version('clutchdiag')}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    _command(commands.add_parser("init", help="make an authority"), "init")
    server = commands.add_parser("server", help="make or renew the certificate of a broker")
    server.add_argument("name", help="name of the files")
    server.add_argument("--host", action="append", default=[], help="name or address of the broker; may be repeated")
    _command(server, "server")
    client = commands.add_parser("client", help="make or renew the certificate of a vehicle or a backend")
    client.add_argument("name", help="vehicle id, or the name of the backend: the common name of the certificate")
    _command(client, "client")
    return parser


def _command(parser: argparse.ArgumentParser, name: str) -> None:
    parser.add_argument("--folder", type=Path, default=Path("certificates"), help="default: %(default)s")
    parser.add_argument("--days", type=float, default=_DAYS[name], help="until it expires (default: %(default)g)")
