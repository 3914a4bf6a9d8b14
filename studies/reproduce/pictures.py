"""The pictures 5 to 16 of the paper, from this project's plant."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from io import BytesIO
from typing import Literal

import numpy as np
from matplotlib import style
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from canlog.arrays import FloatArray
from clutch_model.pack import friction_law, kinetic_friction
from clutch_model.units import bar_from_pa, rpm_from_rad_s
from demo.drawing import CLUTCH_COLOUR, INK, MUTED, STYLE
from diag_service.diagnosis.friction.paper.driveline import SteadyKalman
from diag_service.diagnosis.friction.paper.method import PaperEstimates, PaperSignals, coulomb_gate, static_gate
from ecu_emulator.plant.state import Col
from ecu_emulator.shift_control.tcu_data import HOLD, TORQUE
from studies.reproduce.differences import central_difference
from studies.reproduce.drives import PERIOD_S, BoolArray, PaperDrive
from studies.reproduce.study import CALIBRATION, CLUTCHES, Setup, analysed, fitted

LegendPlace = Literal["upper right", "upper left", "lower left", "center right"]  # where the lines leave room

WIDE_INCH, TALL_INCH = (9.6, 3.6), (9.6, 4.6)
DOTS_PER_INCH = 110
BEFORE_S, AFTER_S = 0.5, 1.2  # of the 2-3 upshift, about the start of its torque phase
SLIP_MAX_RAD_S = 150.0
NOISE_COLOUR = "#9fb3c4"
MICRO = 1e6


@dataclass(frozen=True, slots=True, kw_only=True)
class Picture:
    """One picture of the paper, redrawn."""

    number: int
    caption: str
    png: bytes


@dataclass(frozen=True, slots=True, kw_only=True)
class Run:
    """The method on one sensor set."""

    signals: PaperSignals
    setup: Setup
    analysis: PaperEstimates


def run_of(signals: PaperSignals, setup: Setup) -> Run:
    """Return the method's way through a sensor set."""
    return Run(signals=signals, setup=setup, analysis=analysed(signals, setup))


def pictures(drive: PaperDrive, noiseless: Run, noisy: Run) -> Iterator[Picture]:
    """Yield the pictures in the paper's order; ``drive`` is the one of both runs."""
    shift = upshift_rows(drive)
    time_s = drive.rows[:, Col.T_S]
    cycle = first_cycle(drive)
    yield _picture(
        5,
        "Friction coefficient over slip: the true curve, the samples that pass the gates (noiseless, three cycles) and "
        "the curve through the estimates. Steep rows of samples are torque phases: slip stands still while the film "
        "lags behind the pressure. The paper's own Figure 5 shows test-bench data of a new plate, which are lost.",
        TALL_INCH,
        2,
        lambda panels: _curves(panels, drive, noiseless),
    )
    yield _picture(
        6,
        "Clutch hub speed over one cycle, without and with noise of 10 %.",
        WIDE_INCH,
        1,
        lambda panels: _over(
            panels[0],
            time_s[cycle],
            rpm_from_rad_s(noisy.signals.hub_rad_s[cycle]),
            rpm_from_rad_s(noiseless.signals.hub_rad_s[cycle]),
            "Clutch hub speed [rpm]",
            "lower left",
        ),
    )
    yield _picture(
        7,
        "Pressure of clutch 1 over one cycle, without and with noise of 5 %.",
        WIDE_INCH,
        1,
        lambda panels: _over(
            panels[0],
            time_s[cycle],
            bar_from_pa(noisy.signals.pressure_pa[0, cycle]),
            bar_from_pa(noiseless.signals.pressure_pa[0, cycle]),
            "Pressure of clutch 1 [bar]",
            "upper right",
        ),
    )
    yield from _accelerations(noiseless, noisy, shift)
    for number, run, word in ((11, noiseless, "noiseless"), (12, noisy, "noisy")):
        yield _picture(
            number,
            f"Friction torques in a 2-3 upshift, {word}: estimated by least squares, eq. (9), and simulated.",
            TALL_INCH,
            1,
            lambda panels, run=run: _torques(panels[0], drive, run, shift),  # type: ignore[misc]  # binds the loop's run
        )
    for number, run, word in ((13, noiseless, "noiseless"), (15, noisy, "noisy")):
        yield _picture(
            number,
            f"Film thickness in a 2-3 upshift, {word}: from the table of film against pressure, and simulated.",
            WIDE_INCH,
            2,
            lambda panels, run=run: _films(panels, drive, run, shift),  # type: ignore[misc]  # as above
        )
        yield _picture(
            number + 1,
            f"Viscous torque in a 2-3 upshift, {word}: eq. (17) with the film of the table, and simulated.",
            WIDE_INCH,
            2,
            lambda panels, run=run: _viscous(panels, drive, run, shift),  # type: ignore[misc]  # as above
        )


def first_cycle(drive: PaperDrive) -> slice:
    """Return the rows until 1st gear is back."""
    gear = drive.rows[:, Col.CURRENT_GEAR]
    return slice(0, int(np.argmax((gear[:-1] == 2) & (gear[1:] == 1))) + round(AFTER_S / PERIOD_S))


def upshift_rows(drive: PaperDrive) -> slice:
    """Return the rows around the first 2-3 upshift."""
    rows = drive.rows
    is_shift = (rows[:, Col.CURRENT_GEAR] == 2) & (rows[:, Col.TARGET_GEAR] == 3) & (rows[:, Col.SHIFT_PHASE] == TORQUE)
    start = int(np.argmax(is_shift))
    return slice(start - round(BEFORE_S / PERIOD_S), start + round(AFTER_S / PERIOD_S))


def _picture(
    number: int, caption: str, size_inch: tuple[float, float], columns: int, draw: Callable[[list[Axes]], None]
) -> Picture:
    with style.context(STYLE):
        figure = Figure(figsize=size_inch, dpi=DOTS_PER_INCH, layout="constrained")
        panels = figure.subplots(1, columns, squeeze=False)[0]
        draw(list(panels))
        png = BytesIO()
        figure.savefig(png, format="png")
    return Picture(number=number, caption=caption, png=png.getvalue())


def _over(axes: Axes, x: FloatArray, noisy: FloatArray, clean: FloatArray, title: str, place: LegendPlace) -> None:
    axes.plot(x, noisy, color=NOISE_COLOUR, lw=0.4)
    axes.plot([], [], color=NOISE_COLOUR, lw=4.0, label="noisy")  # as the eye sees it
    axes.plot(x, clean, color=INK, lw=1.3, label="noiseless")
    axes.set_title(title)
    axes.set_xlabel("time [s]")
    _legend(axes, place)


def _accelerations(noiseless: Run, noisy: Run, shift: slice) -> Iterator[Picture]:
    x = _shift_time_s(shift)
    ideal = noiseless.analysis.speeds.hub.rate[shift]
    raw = central_difference(noisy.signals.hub_rad_s, PERIOD_S).rate[shift]

    def draw_raw(panels: list[Axes]) -> None:
        panels[0].plot(x, raw / 1e3, color=NOISE_COLOUR, lw=0.5, label="from the noisy speed")
        panels[0].plot(x, ideal / 1e3, color=INK, lw=1.4, label="from the noiseless speed")
        _finish_shift(panels[0], "Clutch hub acceleration by central differences [1000 rad/s²]", "upper right")

    def draw_filtered(panels: list[Axes]) -> None:
        panels[0].plot(x, noisy.analysis.speeds.hub.rate[shift], color=CLUTCH_COLOUR[1], lw=1.2, label="Kalman filter")
        panels[0].plot(x, ideal, color=INK, lw=1.2, label="ideal")
        _finish_shift(panels[0], "Clutch hub acceleration [rad/s²]", "lower left")

    yield _picture(
        8,
        "Hub acceleration in a 2-3 upshift by central differences, eq. (10): noise drowns it.",
        WIDE_INCH,
        1,
        draw_raw,
    )
    kalman = noisy.setup.differentiators.speed
    if isinstance(kalman, SteadyKalman):
        yield _picture(
            9,
            "The steady Kalman estimator, eqs. (11) to (16), as a filter: what it does to the derivative at each "
            "frequency. The paper's Figure 9 is its block diagram.",
            WIDE_INCH,
            2,
            lambda panels: _response(panels, kalman),
        )
    yield _picture(
        10,
        "Hub acceleration in a 2-3 upshift: Kalman filter on the noisy speed, and ideal. The best match still lags by "
        "about 0.1 s.",
        WIDE_INCH,
        1,
        draw_filtered,
    )


def _response(panels: list[Axes], kalman: SteadyKalman) -> None:
    impulse = np.zeros(1 << 13)
    impulse[1] = 1.0
    rate = kalman(impulse, PERIOD_S).rate[1:]
    frequency_hz = np.fft.rfftfreq(len(rate), PERIOD_S)[1:]
    omega = 2.0 * np.pi * frequency_hz
    relative = np.fft.rfft(rate)[1:] / (1j * omega)
    panels[0].loglog(frequency_hz, np.abs(relative), color=INK, lw=1.6)
    panels[0].set_title("Gain, relative to an ideal derivative")
    delay_s = -np.gradient(np.unwrap(np.angle(relative)), omega)
    panels[1].semilogx(frequency_hz, 1e3 * delay_s, color=INK, lw=1.6)
    panels[1].set_title("Group delay [ms]")
    for axes in panels:
        axes.set_xlim(0.2, 500.0)
        axes.set_xlabel("frequency [Hz]")


def _curves(panels: list[Axes], drive: PaperDrive, run: Run) -> None:
    slip_rad_s = np.linspace(0.0, SLIP_MAX_RAD_S, 400)
    for clutch, axes in zip(CLUTCHES, panels, strict=True):
        data, believed = run.analysis.clutches[clutch - 1].data, CALIBRATION.clutches[clutch - 1].friction
        estimate = fitted(run.analysis, run.setup.gates)[clutch - 1]
        coulomb = coulomb_gate(data, run.setup.gates)
        static = static_gate(data, run.setup.gates, believed.lock_band_rad_s, believed.mu_s)
        axes.plot(
            data.slip_rad_s[coulomb], data.mu[coulomb], ".", color=NOISE_COLOUR, ms=2.5, label="samples for $µ_C$"
        )
        axes.plot(
            np.abs(data.slip_rad_s[static]),
            data.mu[static],
            ".",
            color=CLUTCH_COLOUR[2],
            ms=3.0,
            label="samples for $µ_S$",
        )
        true = friction_law(drive.truth.clutches[clutch - 1].friction)
        axes.plot(slip_rad_s, [kinetic_friction(one, true) for one in slip_rad_s], color=INK, lw=1.8, label="true")
        if estimate.mu_c is not None and estimate.mu_s is not None:
            found = true._replace(mu_c=estimate.mu_c, mu_s=estimate.mu_s)
            fit_mu = [kinetic_friction(one, found) for one in slip_rad_s]
            axes.plot(slip_rad_s, fit_mu, color=CLUTCH_COLOUR[1], lw=1.8, ls="--", label="fit")
        axes.set(xlim=(-2.0, SLIP_MAX_RAD_S), ylim=(0.08, 0.16), xlabel="slip [rad/s]")
        axes.set_title(f"Clutch {clutch}: friction coefficient")
    _legend(panels[0], "upper right")


def _torques(axes: Axes, drive: PaperDrive, run: Run, shift: slice) -> None:
    x = _shift_time_s(shift)
    for clutch in CLUTCHES:
        simulated = drive.rows[shift, Col.CLUTCH1_TORQUE + clutch - 1]
        axes.plot(x, simulated, color=CLUTCH_COLOUR[clutch], lw=5.0, alpha=0.35, label=f"clutch {clutch}, simulated")
    for clutch in CLUTCHES:
        estimated = run.analysis.clutches[clutch - 1].friction_nm[shift]
        axes.plot(x, estimated, color=INK, lw=1.1, ls=("-", "--")[clutch - 1], label=f"clutch {clutch}, estimated")
    _mark_phases(axes, drive, shift)
    _finish_shift(axes, "Friction torque [Nm]", "center right")


def _films(panels: list[Axes], drive: PaperDrive, run: Run, shift: slice) -> None:
    x = _shift_time_s(shift)
    for clutch, axes in zip(CLUTCHES, panels, strict=True):
        table_um = MICRO * run.analysis.clutches[clutch - 1].film_m[shift]
        true_um = MICRO * drive.rows[shift, Col.FILM1 + clutch - 1]
        axes.semilogy(x, table_um, color=CLUTCH_COLOUR[clutch], lw=1.2, label="table")
        axes.semilogy(x, true_um, color=INK, lw=1.4, label="simulated")
        axes.set_ylim(2.0, 300.0)
        _finish_shift(axes, f"Clutch {clutch}: film [µm]", "upper right" if clutch == 1 else "upper left")


def _viscous(panels: list[Axes], drive: PaperDrive, run: Run, shift: slice) -> None:
    x = _shift_time_s(shift)
    for clutch, axes in zip(CLUTCHES, panels, strict=True):
        estimated = run.analysis.clutches[clutch - 1].viscous_nm[shift]
        axes.plot(x, estimated, color=CLUTCH_COLOUR[clutch], lw=1.0, label="estimated")
        axes.plot(x, drive.rows[shift, Col.VISCOUS1_TORQUE + clutch - 1], color=INK, lw=1.4, label="simulated")
        _finish_shift(axes, f"Clutch {clutch}: viscous torque [Nm]", "upper right" if clutch == 1 else "lower left")


def _mark_phases(axes: Axes, drive: PaperDrive, shift: slice) -> None:
    slipping: BoolArray = drive.rows[shift, Col.SHIFT_PHASE] != HOLD
    x = _shift_time_s(shift)[slipping]
    axes.axvspan(float(x[0]), float(x[-1]), color=MUTED, alpha=0.10, lw=0.0, zorder=0)


def _shift_time_s(shift: slice) -> FloatArray:
    return np.arange(shift.stop - shift.start) * PERIOD_S - BEFORE_S


def _finish_shift(axes: Axes, title: str, place: LegendPlace) -> None:
    axes.set_title(title)
    axes.set_xlabel("time since the torque phase began [s]")
    _legend(axes, place)


def _legend(axes: Axes, place: LegendPlace) -> None:
    axes.legend(loc=place, handlelength=1.6, frameon=True, framealpha=0.85, edgecolor="none")
