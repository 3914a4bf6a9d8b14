"""The words of the commands about lakes and clusters: data alone, for the program imports it to show its help."""

from typing import Final

import click

from clutchdiag_io.command_line import FILE, FILE_OR_STORE, FLOAT, INT, VERBOSE, Command, Group, Option
from diag_service.commands.asking_arguments import JSON, PROGRAM

DEFAULT_LIMIT_S: Final = 600.0  # an hour of a bus takes half a minute
_LAKE: Final = click.Argument(
    ["lake"], type=FILE_OR_STORE, metavar="LAKE", help="folder, or s3://BUCKET/PREFIX and such"
)
_TLS: Final = (
    Option("--ca FILE", "authority of the cluster", FILE, required=True),
    Option("--cert FILE", "our certificate", FILE, required=True),
    Option("--key FILE", "its key, readable for its owner only", FILE, required=True),
)
_HOST: Final = Option("--host HOST", "address to listen at (default: 127.0.0.1)", default="127.0.0.1")
LAKE_OPTIONS: Final = (
    Option(
        "--lake PLACE",
        "make or continue a lake of Parquet files in this folder or store (s3://BUCKET/PREFIX and such); the logs may "
        "be in a store, too",
        FILE_OR_STORE,
    ),
    Option(
        "--scheduler ADDRESS",
        "who works for a lake: local, or the workers of tls://HOST:PORT, with --ca, --cert and --key (default: local)",
        default="local",
    ),
    Option(
        "--signals NAME,NAME...",
        "for a lake: decoded signals, too; Message.Signal or the signal alone, with * for anything",
    ),
    Option(
        "--time-limit S",
        f"for a lake: give up on a log after this time (default: {DEFAULT_LIMIT_S:g})",
        FLOAT,
        default=DEFAULT_LIMIT_S,
    ),
    Option("--retry", "for a lake: try again the logs that failed before"),
)
LAKE: Final = Group(
    "lake",
    "look after a lake of results",
    Command(
        "check",
        "show what is in a lake, and whether its manifest and its parts agree",
        _LAKE,
        Option("--repair", "remove parts that no log of the manifest has, as a killed run may leave"),
        VERBOSE,
        examples=(f"{PROGRAM} lake check s3://fleet/lake",),
    ),
    Command(
        "forget",
        "remove one vehicle from a lake and check that nothing is left",
        _LAKE,
        click.Argument(["vehicle"], metavar="VEHICLE", help="vehicle id"),
        *(JSON, VERBOSE),
        description="Remove every part of one vehicle and its rows of the manifest, list them, and check again. Logs "
        "and copies elsewhere stay.",
        examples=(f"{PROGRAM} lake forget s3://fleet/lake car7",),
    ),
    metavar="ACTION",
)
CLUSTER: Final = Group(
    "cluster",
    "run a part of a cluster that analyses logs into a lake",
    Command(
        "scheduler",
        "distribute the work of runs to workers",
        *(_HOST, Option("--port PORT", "port to listen at (default: 8786)", INT, default=8786), *_TLS),
        Option(
            "--dashboard [HOST:]PORT",
            "show its state to browsers there, without TLS (default: a free port, to this machine)",
        ),
        VERBOSE,
        examples=(f"{PROGRAM} cluster scheduler --ca ca.crt --cert node1.crt --key node1.key",),
    ),
    Command(
        "worker",
        "analyse logs that a scheduler hands out",
        click.Argument(["scheduler"], metavar="ADDRESS", help="tls://HOST:PORT of the scheduler"),
        *(_HOST, Option("--jobs N", "processes, each with a log at a time (default: one per core)", INT)),
        Option(
            "--memory MIB",
            "memory limit of a process, which is ended above it (default: an equal share of the machine's)",
            INT,
        ),
        *(*_TLS, VERBOSE),
        examples=(f"{PROGRAM} cluster worker tls://127.0.0.1:8786 --ca ca.crt --cert node1.crt --key node1.key",),
    ),
    metavar="ACTION",
)
