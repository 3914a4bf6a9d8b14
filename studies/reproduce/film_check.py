"""The method with the simulated film in place of the table: what is left of its noiseless error is not the table's."""

from collections.abc import Sequence

from diag_service.diagnosis.friction.paper import PaperEstimate
from diag_service.diagnosis.friction.paper.friction_data import fit, friction_data, viscous_torques_nm
from ecu_emulator.plant import Col
from studies.reproduce.drives import PaperDrive
from studies.reproduce.study import CALIBRATION, Errors, Setup, analysed, errors_of


def known_film_errors(drives: Sequence[PaperDrive], setup: Setup) -> Errors:
    """Return the noiseless errors with the true film thickness and pack temperature."""
    return errors_of({drive.case: [_estimates(drive, setup)] for drive in drives}, drives)


def _estimates(drive: PaperDrive, setup: Setup) -> tuple[PaperEstimate, PaperEstimate]:
    analysis = analysed(drive.signals, setup)
    found = []
    for m, (believed, clutch) in enumerate(zip(CALIBRATION.clutches, analysis.clutches, strict=True)):
        film_m = drive.rows[:, Col.FILM1 + m].copy()
        clutch_k = drive.rows[:, Col.CLUTCH1_TEMPERATURE + m].copy()
        slip_rad_s = clutch.data.slip_rad_s
        viscous_nm = viscous_torques_nm(slip_rad_s, film_m, clutch_k, believed, CALIBRATION.viscosity)
        contact_nm = clutch.friction_nm - viscous_nm
        data = friction_data(contact_nm, slip_rad_s, film_m, clutch.pressure.rate, clutch.data.is_shifting, believed)
        found.append(fit(data, setup.gates, believed.friction))
    return found[0], found[1]
