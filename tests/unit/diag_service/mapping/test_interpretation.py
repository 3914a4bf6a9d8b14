"""Without a profile the one that fits is taken, and said; where none fits it is said what is missing."""

import logging
from pathlib import Path

import cantools
import pytest
from cantools.database.can import Database

from diag_service.diagnosis.records import Tier
from diag_service.errors import ConfigError
from diag_service.mapping.interpretation import choose_profile, interpret

HYUNDAI_LIKE = """VERSION ""
BU_: A
BO_ 128 EMS_DCT11: 8 A
 SG_ TQ_STND : 8|6@1+ (10,0) [0|630] "Nm" A
 SG_ N : 16|16@1+ (0.25,0) [0|16383.75] "rpm" A
 SG_ TQFR : 40|8@1+ (0.390625,0) [0|99.6] "%" A
 SG_ TQI : 48|8@1+ (0.390625,0) [0|99.6] "%" A
BO_ 274 TCU12: 8 A
 SG_ CUR_GR : 8|4@1+ (1,0) [0|15] "" A
BO_ 275 TCU13: 8 A
 SG_ CF_Tcu_TarGr : 20|4@1+ (1,0) [0|15] "" A
"""


def database(text: str) -> Database:
    loaded = cantools.database.load_string(text, "dbc")
    assert isinstance(loaded, Database)
    return loaded


def test_part_of_a_profile_is_enough_for_part_of_the_diagnosis() -> None:
    fit = choose_profile(database(HYUNDAI_LIKE))
    assert (fit.profile.name, fit.tier) == ("hyundai_dct", Tier.KINEMATIC)
    assert fit.said.startswith("profile hyundai_dct: 4 of 13 signals, tier 3; torque capacity needs clutch1_torque")


def test_a_database_that_no_profile_fits() -> None:
    with pytest.raises(ConfigError, match=r"no shipped profile fits .* dct: the database has no message ECM_Torq"):
        choose_profile(database('VERSION ""\nBU_: A\nBO_ 1 M: 8 A\n SG_ S : 0|8@1+ (1,0) [0|255] "" A\n'))


def test_the_choice_is_said_aloud(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = tmp_path / "car.dbc"
    path.write_text(HYUNDAI_LIKE, encoding="utf-8")
    with caplog.at_level(logging.INFO, logger="diag_service"):
        meaning = interpret(path, None)
    assert "profile hyundai_dct: 4 of 13 signals" in caplog.text
    assert [file.name for file in meaning.files] == ["car.dbc", "hyundai_dct.toml"]
