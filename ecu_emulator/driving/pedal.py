"""What the accelerator pedal asks for: a force at the wheels, whatever the gear; the driver knows it by heart."""

from canlog.jit import kernel
from ecu_emulator.driving.parameters import PedalParameters


@kernel
def full_force_n(vehicle_m_s: float, p: PedalParameters) -> float:
    """Return the force at the wheels that the full pedal asks for [N]."""
    return min(p.force_n, p.power_w / max(vehicle_m_s, 1.0))


@kernel
def asked_force_n(pedal: float, vehicle_m_s: float, overrun_n: float, p: PedalParameters) -> float:
    """Return the force at the wheels [N] that a pedal asks for; released, the engine brakes with ``overrun_n`` < 0."""
    if pedal >= p.overrun_ratio:
        return (pedal - p.overrun_ratio) / (1.0 - p.overrun_ratio) * full_force_n(vehicle_m_s, p)
    return (1.0 - pedal / p.overrun_ratio) * overrun_n


@kernel
def pedal_for_force(force_n: float, vehicle_m_s: float, overrun_n: float, p: PedalParameters) -> float:
    """Return the pedal that asks for a force at the wheels: `asked_force_n` solved for it, within 0..1."""
    if force_n >= 0.0:
        share = force_n / full_force_n(vehicle_m_s, p)
        return min(p.overrun_ratio + share * (1.0 - p.overrun_ratio), 1.0)
    if overrun_n >= 0.0:
        return 0.0
    return max(p.overrun_ratio * (1.0 - force_n / overrun_n), 0.0)
