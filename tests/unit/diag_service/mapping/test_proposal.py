"""Profiles proposed from names, units and values, and what comes of them."""

import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from canlog.decode.signals import Decoded
from diag_service.diagnosis.columns import Signal
from diag_service.mapping.profile import load_profile
from diag_service.mapping.proposal import SignalStatistics, candidates, profile_text


def stat(
    place: str, unit: str, lowest: float, highest: float, *, is_integer: bool = False, count: int = 100
) -> SignalStatistics:
    message, signal = place.split(".")
    return SignalStatistics(
        message=message, signal=signal, unit=unit, count=count, lowest=lowest, highest=highest, is_integer=is_integer
    )


def proposed(*statistics: SignalStatistics) -> dict[Signal, str]:
    return {signal: found[0].statistics.place for signal, found in candidates(statistics).items()}


@pytest.mark.parametrize(
    ("signal", "found"),
    [
        (Signal.ENGINE_SPEED, stat("Motor_12.MO_Drehzahl_01", "Unit_MinutInver", 700, 5000)),
        (Signal.ENGINE_SPEED, stat("EMS11.N", "rpm", 700, 5000)),
        (Signal.ENGINE_TORQUE, stat("Motor_11.MO_Mom_Ist_Summe", "Unit_NewtoMeter", -40, 300)),
        (Signal.CLUTCH_TORQUE, stat("Getriebe_12.GE_Aufnahmemoment", "Unit_NewtoMeter", -40, 300)),
        (Signal.CLUTCH_TORQUE, stat("TCU_DCT13.Clutch_Driving_Tq", "Nm", -40, 300)),
        (Signal.TARGET_GEAR, stat("Getriebe_11.GE_Zielgang", "", 1, 7, is_integer=True)),
        (Signal.CURRENT_GEAR, stat("TCU12.CUR_GR", "", 0, 7, is_integer=True)),
        (Signal.INPUT_SPEED, stat("Getriebe_13.GE_Eingangsdrehz", "Unit_MinutInver", 0, 5000)),
        (Signal.SUMP_TEMPERATURE, stat("Getriebe_14.GE_Sumpftemperatur", "Unit_DegreCelsi", 20, 90)),
        (Signal.SUMP_TEMPERATURE, stat("TCU11.TEMP_AT", "deg", 20, 90)),
        (Signal.INPUT1_SPEED, stat("T.InputShaft1Speed", "rpm", 0, 5000)),
        (Signal.INPUT2_SPEED, stat("T.InputShaft2Speed", "rpm", 0, 5000)),
    ],
)
def test_public_names_are_recognised(signal: Signal, found: SignalStatistics) -> None:
    assert proposed(found)[signal] == found.place


@pytest.mark.parametrize(
    "wrong",
    [
        stat("M.EngineSpeed", "km/h", 0, 200),  # unit of another kind
        stat("M.EngineSpeed", "rpm", 0, 60_000),  # beyond any engine
        stat("M.EngineSpeedStatus", "rpm", 0, 3),
        stat("M.EngineSpeed", "rpm", 0, 0, count=0),
        stat("M.CurrentGear", "", 0.5, 3),
        stat("M.Speed7", "rpm", 0, 3000),
    ],
)
def test_what_cannot_be_is_not_proposed(wrong: SignalStatistics) -> None:
    assert proposed(wrong) == {}


def test_the_proposal_is_a_profile(tmp_path: Path) -> None:
    found = candidates([stat("P.Clutch1Pressure", "bar", 0, 20), stat("P.Clutch1PressureCmd", "bar", 0, 20)])
    text = profile_text('a "log"', found, ["Check every line.", ""])
    assert text.startswith('# Check every line.\n#\nname = "a \\"log\\""\n')
    assert "# or: clutch1_pressure_pa" in text
    assert tomllib.loads(text)["name"] == 'a "log"'
    path = tmp_path / "car.toml"
    path.write_text(text, encoding="utf-8")
    assert load_profile(path).sources.keys() == {Signal.CLUTCH1_PRESSURE}


@pytest.mark.parametrize(("first_unit", "unit"), [("", "kPa"), ("psi", "psi")])
def test_pressures_of_both_clutches_have_one_unit(first_unit: str, unit: str) -> None:
    first, second = (
        SignalStatistics(message=name, signal=name, unit="", is_column=True)
        for name in ("Clutch 1 Pressure", "Clutch 2 Pressure")
    )
    first = replace(first, unit=first_unit)
    first.add(Decoded(value=np.arange(0.0, 30.0), is_good=None))  # of a clutch that was hardly closed: by itself bar
    second.add(Decoded(value=np.arange(0.0, 990.0, 5.86), is_good=None))
    best = candidates([first, second])
    assert [best[signal][0].unit for signal in (Signal.CLUTCH1_PRESSURE, Signal.CLUTCH2_PRESSURE)] == [unit, unit]
