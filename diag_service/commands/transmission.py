"""``diag-service transmission``: a described transmission, its gears, and which change tells which element."""

from collections.abc import Iterator
from types import SimpleNamespace
from typing import Final

import numpy as np

from clutch_model.transmission import Transmission, read_transmission
from diag_service.console import write_record
from diag_service.service.stopping import Controls
from fleet_contract import JsonObject

SCHEMA: Final = "clutchdiag/transmission/v1"


def execute(options: SimpleNamespace, controls: Controls) -> None:
    del controls
    transmission = read_transmission(options.file)
    write_record(record(transmission), said(transmission), as_json=options.json)


def record(transmission: Transmission) -> JsonObject:
    """Return ratios, levers and slips of all gears, and what each change of one element tells."""
    gears: list[JsonObject] = [
        {
            "number": one.number,
            "ratio": transmission.ratio(one),
            "levers": transmission.levers(one),
            "slips": {name: slip for name, slip in transmission.slips(one).items() if np.isfinite(slip)},
        }
        for one in transmission.gears
    ]
    changes: list[JsonObject] = [
        {
            "lower": one.lower,
            "upper": one.upper,
            "elements": {
                name: {"slip_by_input": slip.by_input, "slip_by_output": slip.by_output}
                for name, slip in zip((one.coming, one.going), one.slips, strict=True)
            },
            "told": [name for name, *_ in one.told],
        }
        for one in transmission.changes()
    ]
    return {"schema": SCHEMA, "name": transmission.name, "gears": gears, "changes": changes}


def said(transmission: Transmission) -> Iterator[str]:
    """Yield the same for people, a line each."""
    yield transmission.name
    for one in transmission.gears:
        levers = ", ".join(f"{name} {lever:+.2f}" for name, lever in transmission.levers(one).items())
        gear = "reverse" if one.number < 0 else f"gear {one.number}"
        yield f"{gear}: ratio {transmission.ratio(one):.3f}; torque over the input's: {levers}"
    told: dict[str, list[str]] = {one.name: [] for one in transmission.elements}
    for change in transmission.changes():
        for name, gears, slip in change.told:
            told[name].append(f"{gears[0]}-{gears[1]} (lever {slip.by_input:+.2f})")
    for name, changes in told.items():
        yield f"{name} can be told from {', '.join(changes)}" if changes else f"{name}: no change of gears tells it"
