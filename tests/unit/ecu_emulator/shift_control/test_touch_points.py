"""Touch points found in what sensors say of pressure steps."""

from collections.abc import Sequence

import pytest

from ecu_emulator.shift_control.touch_points import FINE_PA, Felt, PressureSteps, Sample, finding_of

STEPS = PressureSteps(clutch=1, top_pa=1.44e5, down_pa=FINE_PA, count=9)


def told(loads_nm: Sequence[float], *, shaft_rad_s: float = 0.0, left_out: int | None = None) -> list[Sample]:
    """Return what sensors without noise say of steps in which the clutch carries so much."""
    commands = [(0.0, 1.0, 0.0), (7e5, 0.2, 0.0), (STEPS.top_pa + 0.2e5, 0.5, 20.0)]
    commands += [(STEPS.pressure_pa(step), 0.8, load) for step, load in enumerate(loads_nm) if step != left_out]
    samples: list[Sample] = []
    for command_pa, duration_s, torque_nm in [*commands, (0.0, 0.5, 0.0)]:
        for _ in range(round(duration_s * 100)):
            t_s = 7.0 + 0.01 * len(samples)
            samples.append(
                Sample(
                    t_s=t_s, command_pa=round(command_pa, -3), engine_torque_nm=torque_nm - 2.0,
                    engine_speed_rad_s=75.0, shaft_speed_rad_s=shaft_rad_s,
                )
            )  # fmt: skip
    return samples


@pytest.mark.parametrize(
    ("loads_nm", "felt", "pressure_pa"),
    [
        ([9, 8, 7, 6, 0, 0, 0, 0, 0], Felt.BETWEEN, 1.37e5),
        ([9, 8, 1.0, 6, 5, 0, 0, 0, 0], Felt.BETWEEN, 1.35e5),  # one that is not felt between others is noise
        ([9, 8, 7, 0, 0, 0, 2, 0, 0], Felt.BETWEEN, 1.39e5),  # likewise
        ([0] * 9, Felt.NEVER, None),
        ([12, 11, 10, 9, 8, 7, 6, 5, 4], Felt.ALWAYS, None),
    ],
)
def test_the_touch_point_lies_between_what_is_felt_and_what_is_not(
    loads_nm: list[float], felt: Felt, pressure_pa: float | None
) -> None:
    found = finding_of(told(loads_nm), STEPS)
    assert found.felt is felt
    assert pressure_pa is None or found.pressure_pa == pytest.approx(pressure_pa)
