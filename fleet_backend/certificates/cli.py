"""Command line: ``fleet-certificates init|server|client``; the same command renews."""

import argparse
import sys
from collections.abc import Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Final, NoReturn

from fleet_backend.certificates.errors import CertificateError

PROGRAM: Final = "fleet-certificates"
EXIT_OK, EXIT_UNEXPECTED, EXIT_USAGE = range(3)
_EXIT_TEXT: Final = "exit status: 0 done, 1 unexpected error, 2 usage, or an extra that is not installed"
_DAYS: Final = {"init": 3650.0, "server": 398.0, "client": 90.0}


def main(arguments: Sequence[str] | None = None) -> int:
    """Make what is asked for and return the exit status."""
    options = _parser().parse_args(arguments)
    try:
        _execute(options)
    except CertificateError as exc:
        sys.stderr.write(f"{PROGRAM}: error: {exc}\n")
        return EXIT_USAGE
    except Exception as exc:  # noqa: BLE001 - the one place where nothing may pass
        sys.stderr.write(f"{PROGRAM}: error: unexpected {type(exc).__name__}: {' '.join(str(exc).split())}\n")
        return EXIT_UNEXPECTED
    return EXIT_OK


def _execute(options: argparse.Namespace) -> None:
    try:
        from fleet_backend.certificates.authority import Authority, Lifetime  # noqa: PLC0415 - needs the extra
    except ModuleNotFoundError as exc:
        if exc.name is None or exc.name.startswith("fleet_backend.certificates"):
            raise
        raise CertificateError(f"the module {exc.name} is not installed: pip install 'clutchdiag[security]'") from exc
    lifetime = Lifetime.of_days(options.days, datetime.now(UTC))
    if options.command == "init":
        Authority.make(options.folder, lifetime)
    elif options.command == "server":
        Authority.open(options.folder).issue_server(options.name, options.host, lifetime)
    else:
        Authority.open(options.folder).issue_client(options.name, lifetime)


class _Parser(argparse.ArgumentParser):
    """A parser that complains in one line, as everything else does."""

    def error(self, message: str) -> NoReturn:
        self.exit(EXIT_USAGE, f"{PROGRAM}: error: {message} (see {self.prog} --help)\n")


def _parser() -> _Parser:
    parser = _Parser(
        prog=PROGRAM,
        epilog=_EXIT_TEXT,
        description="Makes and renews certificates of a test authority, for trials: its key lies in the same folder. "
        "A certificate that exists is replaced, whole; running services take the new one by themselves.",
    )
    parser.add_argument("--version", action="version", version=f"{PROGRAM} {version('clutchdiag')}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    _command(commands.add_parser("init", help="make an authority", epilog=_EXIT_TEXT), "init")
    server = commands.add_parser("server", help="make or renew the certificate of a broker", epilog=_EXIT_TEXT)
    server.add_argument("name", help="name of the files")
    server.add_argument("--host", action="append", default=[], help="name or address of the broker; may be repeated")
    _command(server, "server")
    client = commands.add_parser(
        "client", help="make or renew the certificate of a vehicle or a backend", epilog=_EXIT_TEXT
    )
    client.add_argument("name", help="vehicle id, or the name of the backend: the common name of the certificate")
    _command(client, "client")
    return parser


def _command(parser: argparse.ArgumentParser, name: str) -> None:
    parser.add_argument("--folder", type=Path, default=Path("certificates"), help="default: %(default)s")
    parser.add_argument("--days", type=float, default=_DAYS[name], help="until it expires (default: %(default)g)")
