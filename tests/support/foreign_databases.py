"""Databases with the messages and signals that a shipped profile names, for drives in the code of such a vehicle."""

from pathlib import Path

from diag_service.diagnosis.columns import Signal
from diag_service.mapping.profile import BusSource, Profile
from diag_service.mapping.units import kind_of_unit

FIRST_ID = 0x100
BITS = 12  # of each signal: five of them fit into a message
_LAYOUT = {  # by SI unit: unit of the database, step, whether it is signed, offset
    "rad_s": ("rpm", 2.0, False, 0.0),
    "m_s": ("km/h", 0.0625, False, 0.0),
    "nm": ("Nm", 0.25, True, 0.0),
    "pa": ("bar", 0.01, False, 0.0),
    "k": ("degC", 0.1, False, -48.0),
    "ratio": ("%", 0.4, False, 0.0),
    None: ("", 1.0, False, 0.0),
}
_PLAIN = ("", 0.25, False, 0.0)


def write_database(profile: Profile, path: Path) -> None:
    """Write a DBC with the signals of a profile, and those that correct them."""
    signals: dict[str, dict[str, tuple[str, float, bool, float]]] = {}
    for signal, source in profile.sources.items():
        assert isinstance(source, BusSource)
        entries = signals.setdefault(source.message, {})
        entries[source.signal] = _layout(signal, source)
        entries |= {name: _PLAIN for name in (source.less, source.times) if name is not None}
    lines = ['VERSION ""', "", "BU_: X", ""]
    for number, (message, entries) in enumerate(signals.items()):
        lines.append(f"BO_ {FIRST_ID + number} {message}: 8 X")
        for place, (name, (unit, step, is_signed, offset)) in enumerate(entries.items()):
            sign = "-" if is_signed else "+"
            lines.append(f' SG_ {name} : {place * BITS}|{BITS}@1{sign} ({step},{offset}) [0|0] "{unit}" X')
        lines.append("")
    path.write_text("\n".join(lines), encoding="utf-8")


def _layout(signal: Signal, source: BusSource) -> tuple[str, float, bool, float]:
    unit, step, is_signed, offset = _LAYOUT[kind_of_unit(signal)]
    return ("%", 0.05, True, 0.0) if source.times is not None else (unit, step, is_signed, offset)
