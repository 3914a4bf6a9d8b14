"""Scenario files: TOML becomes a ``Scenario``; every key is checked, and the first one that cannot be used is named."""

import tomllib
from collections.abc import Mapping
from dataclasses import asdict
from importlib.resources import files
from pathlib import Path
from typing import Final

from clutch_model.tables import read_table, record_from
from ecu_emulator.errors import EmulatorConfigError
from ecu_emulator.scenario.faults import (
    NOMINAL_SENSORS,
    BusFault,
    BusFaultKind,
    CauseKind,
    Degradation,
    Fault,
    Sensor,
    SensorFault,
    Sensors,
    split_unit,
)
from ecu_emulator.scenario.scenario import ProductionScatter, Scenario, Truth, production_scatter

_SHIPPED: Final = files("ecu_emulator").joinpath("scenarios")


def shipped_scenarios() -> tuple[str, ...]:
    """Return the names of the scenarios that ship with the package, sorted."""
    return tuple(
        sorted(entry.name.removesuffix(".toml") for entry in _SHIPPED.iterdir() if entry.name.endswith(".toml"))
    )


def load_scenario(name_or_file: str) -> Scenario:
    """Return a shipped scenario by name, or one from a TOML file.

    Raises
    ------
    ConfigError
        Naming the file and the first key that cannot be used.
    """
    if name_or_file in shipped_scenarios():
        text = _SHIPPED.joinpath(f"{name_or_file}.toml").read_text(encoding="utf-8")
        return scenario_of(tomllib.loads(text), f"scenario {name_or_file}")
    path = Path(name_or_file)
    if path.suffix != ".toml" and not path.exists():
        known = ", ".join(shipped_scenarios())
        raise EmulatorConfigError(f"no scenario {name_or_file!r}: use a TOML file or one of {known}")
    return scenario_of(read_table(path, "scenario", EmulatorConfigError), str(path))


def scenario_of(table: Mapping[str, object], origin: str) -> Scenario:
    """Return the scenario of nested tables; ``origin`` begins every error message.

    Raises
    ------
    ConfigError
        Naming the first key that is unknown, mistyped or out of range.
    """
    parts = dict(table)
    try:
        if "scatter" in parts:
            parts["scatter"] = _scatter(parts["scatter"])
        truth = record_from(Truth, parts.get("truth", {}), "truth.", error=EmulatorConfigError)
        parts["truth"] = Truth(calibration=_flat(truth.calibration), plant=_flat(truth.plant))
        parts["sensors"] = _sensors(_subtable(parts, "sensors"))
        return record_from(Scenario, parts, error=EmulatorConfigError)
    except EmulatorConfigError as exc:
        raise EmulatorConfigError(f"{origin}: {exc}") from exc


def parse_fault(table: object) -> Fault:
    """Return one fault by the keys of its scenario table; a sensor fault names a quantity, a cause is its own kind.

    Raises
    ------
    ConfigError
        Naming the first key that cannot be used.
    """
    if not isinstance(table, Mapping):
        raise EmulatorConfigError(f"a fault must be a table, got {table!r}")
    word = str(table.get("kind")).replace("_", "-")
    if word in list(CauseKind):
        return record_from(Degradation, {**table, "kind": word}, error=EmulatorConfigError)
    if "kind" in table and "quantity" not in table and table["kind"] not in list(BusFaultKind):
        kinds = f"{', '.join(BusFaultKind)} (of the bus), {', '.join(CauseKind)} (of the car)"
        raise EmulatorConfigError(f"kind must be one of {kinds}, got {table['kind']!r}")
    kind: type[SensorFault | BusFault] = SensorFault if "quantity" in table else BusFault
    return record_from(kind, table, error=EmulatorConfigError)


def _scatter(value: object) -> ProductionScatter:
    if value == "none":
        return ProductionScatter()
    if not isinstance(value, Mapping):
        raise EmulatorConfigError(f'scatter must be "none" or a table, got {value!r}')
    table = {**asdict(production_scatter()), **value}
    return record_from(ProductionScatter, table, "scatter.", error=EmulatorConfigError)


def _sensors(table: Mapping[str, object]) -> Sensors:
    stems = {split_unit(quantity)[0]: quantity for quantity in NOMINAL_SENSORS}
    sensors = dict(NOMINAL_SENSORS)
    for stem in table:
        where = f"sensors.{stem}"
        if stem not in stems:
            raise EmulatorConfigError(f"{where} is unknown; known: {', '.join(sorted(stems))}")
        quantity = stems[stem]
        unit = split_unit(quantity)[1]
        members = {f"offset_{unit}": "offset", f"noise_std_{unit}": "noise_std"}
        members |= {name: name for name in ("gain_ratio", "latency_s", "lag_s")}
        overrides = _subtable(table, stem, where)
        if unknown := sorted(set(overrides) - set(members)):
            raise EmulatorConfigError(f"{where}.{unknown[0]} is unknown; known: {', '.join(sorted(members))}")
        changed = asdict(sensors[quantity]) | {members[key]: value for key, value in overrides.items()}
        sensors[quantity] = record_from(Sensor, changed, f"{where}.", error=EmulatorConfigError)
    return sensors


def _flat(table: Mapping[str, object], prefix: str = "") -> dict[str, object]:
    flat: dict[str, object] = {}
    for key, value in table.items():
        dotted = f"{prefix}{key}"
        flat |= _flat(value, f"{dotted}.") if isinstance(value, Mapping) else {dotted: value}
    return flat


def _subtable(table: Mapping[str, object], key: str, where: str = "") -> Mapping[str, object]:
    value = table.get(key, {})
    if not isinstance(value, Mapping):
        raise EmulatorConfigError(f"{where or key} must be a table, got {value!r}")
    return value
