"""The table that ships, with routines of every kind, also of those that the vehicle cannot do.

Without OBD, which the model of UDS beside the product knows nothing of.
"""

from functools import cache
from importlib.resources import files
from pathlib import Path

from workshop.controller.table import DiagnosticTable, parse_table


@cache
def full_text() -> str:
    shipped = files("workshop.controller").joinpath("tcu.toml").read_text(encoding="utf-8")
    head, rest = shipped.split("# --- OBD ---", 1)[0].split("obd = true", 1)
    shipped = head + rest.split("\n]\n", 1)[1]  # without its conditions for clearing and its monitors
    return shipped + "\n" + Path(__file__).with_name("routines.toml").read_text(encoding="utf-8")


@cache
def full_table() -> DiagnosticTable:
    return parse_table(full_text(), "tests' table")
