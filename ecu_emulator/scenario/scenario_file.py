"""Scenario files: TOML becomes a ``Scenario``; every key is checked, and the first one that cannot be used is named."""

import tomllib
from collections.abc import Mapping
from dataclasses import fields
from importlib.resources import files
from pathlib import Path
from typing import Final

from canlog.files import read_small_file
from clutch_model.tables import record_from
from ecu_emulator.errors import EmulatorConfigError
from ecu_emulator.scenario.faults import NOMINAL_SENSORS, BusFault, Sensor, SensorFault, Sensors, split_unit
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
        return parse_scenario(text, f"scenario {name_or_file}")
    path = Path(name_or_file)
    if path.suffix != ".toml" and not path.exists():
        known = ", ".join(shipped_scenarios())
        raise EmulatorConfigError(f"no scenario {name_or_file!r}: use a TOML file or one of {known}")
    try:
        text = read_small_file(path).decode("utf-8")
    except OSError as exc:
        raise EmulatorConfigError(f"cannot read scenario {path}: {exc.strerror or exc}") from exc
    except UnicodeDecodeError as exc:
        raise EmulatorConfigError(f"cannot read scenario {path}: {exc}") from exc
    return parse_scenario(text, str(path))


def parse_scenario(text: str, origin: str) -> Scenario:
    """Check the TOML text of a scenario; ``origin`` begins every error message.

    Raises
    ------
    ConfigError
        Naming the first key that is unknown, mistyped or out of range.
    """
    try:
        return _scenario(tomllib.loads(text))
    except tomllib.TOMLDecodeError as exc:
        raise EmulatorConfigError(f"{origin} is not TOML: {exc}") from exc
    except RecursionError as exc:
        raise EmulatorConfigError(f"{origin} is not TOML: its lists or tables are nested too deeply") from exc
    except EmulatorConfigError as exc:
        raise EmulatorConfigError(f"{origin}: {exc}") from exc


def parse_fault(table: object) -> SensorFault | BusFault:
    """Return one fault by the keys of its scenario table; a sensor fault names a quantity.

    Raises
    ------
    ConfigError
        Naming the first key that cannot be used.
    """
    if not isinstance(table, Mapping):
        raise EmulatorConfigError(f"a fault must be a table, got {table!r}")
    if "quantity" in table:
        return record_from(SensorFault, table, error=EmulatorConfigError)
    return record_from(BusFault, table, error=EmulatorConfigError)


def _scenario(table: Mapping[str, object]) -> Scenario:
    parts = dict(table)
    if "scatter" in parts:
        parts["scatter"] = _scatter(parts["scatter"])
    parts["truth"] = _truth(_subtable(parts, "truth"))
    parts["sensors"] = _sensors(_subtable(parts, "sensors"))
    return record_from(Scenario, parts, error=EmulatorConfigError)


def _scatter(value: object) -> ProductionScatter:
    if value == "none":
        return ProductionScatter()
    if not isinstance(value, Mapping):
        raise EmulatorConfigError(f'scatter must be "none" or a table, got {value!r}')
    normal = production_scatter()
    defaults = {member.name: getattr(normal, member.name) for member in fields(ProductionScatter)}
    return record_from(ProductionScatter, {**defaults, **value}, "scatter.", error=EmulatorConfigError)


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
        given = _subtable(table, stem, where)
        _check_known(given, set(members), f"{where}.")
        default = {member.name: getattr(sensors[quantity], member.name) for member in fields(Sensor)}
        changed = {members[key]: value for key, value in given.items()}
        sensors[quantity] = record_from(Sensor, {**default, **changed}, f"{where}.", error=EmulatorConfigError)
    return sensors


def _truth(table: Mapping[str, object]) -> Truth:
    _check_known(table, {"calibration", "plant"}, "truth.")
    return Truth(
        calibration=_flat(_subtable(table, "calibration", "truth.calibration")),
        plant=_flat(_subtable(table, "plant", "truth.plant")),
    )


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


def _check_known(table: Mapping[str, object], known: set[str], prefix: str) -> None:
    unknown = sorted(set(table) - known)
    if unknown:
        raise EmulatorConfigError(f"{prefix}{unknown[0]} is unknown; known: {', '.join(sorted(known))}")
