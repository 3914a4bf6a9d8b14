"""Every command of every program without extras: help and version as ever, else one line that says what to install."""

import re
from importlib.metadata import distribution
from pathlib import Path

import pytest

from tests.support.documents import ROOT
from tests.support.plain_install import PlainInstall, core_distributions, extra_modules, plain_install
from tests.support.ports import free_port

PROGRAMS = {
    "ecu-emulator": "ecu_emulator.cli",
    "diag-service": "diag_service.cli",
    "fleet-backend": "fleet_backend.cli",
}
COMMAND = re.compile(r"^  ([a-z][a-z-]*)(?:  +\S|$)", re.MULTILINE)
CANDUMP = "(1767225600.000000) vcan0 123#0011223344556677\n" * 4
MDF = b"MDF     4.10    asammdf ".ljust(512, b"\0")


@pytest.fixture(name="plain", scope="module")
def _plain(tmp_path_factory: pytest.TempPathFactory) -> PlainInstall:
    return plain_install(tmp_path_factory.mktemp("plain"))


def one_line(program: str, extra: str, text: str) -> None:
    """Hold a complaint against what every complaint of this kind is."""
    assert re.fullmatch(rf"{program}: error: .*pip install '\.\[{extra}\]' in the checkout\n", text), text


def test_what_is_to_be_installed_is_where_pip_finds_it() -> None:
    """The project is in no package index: only its folder can be installed."""
    folders = [
        ROOT / name for name in ("docs", "examples", "demo", "canlog", "diag_service", "ecu_emulator", "fleet_backend")
    ]
    files = [
        ROOT / "README.md",
        *(path for folder in folders for end in ("md", "py") for path in folder.rglob(f"*.{end}")),
    ]
    advice = [line for path in files for line in path.read_text(encoding="utf-8").splitlines() if "pip install" in line]
    assert len(advice) > 10
    assert [line for line in advice if re.search(r"pip install[^`]* '?(clutchdiag|canlog)\b", line)] == []


def test_nothing_of_the_extras_can_be_imported(plain: PlainInstall) -> None:
    modules = sorted(extra_modules())
    assert {"sqlalchemy", "alembic", "psycopg", "pyarrow", "asammdf", "amqtt"} <= set(modules)
    found = plain.run("-c", f"import importlib.util as u; print([m for m in {modules} if u.find_spec(m)])")
    assert found.out == "[]\n"


@pytest.mark.parametrize("program", PROGRAMS)
def test_help_and_version_need_no_extra(plain: PlainInstall, program: str) -> None:
    module = PROGRAMS[program]
    version, text = plain.run_all(module, [["--version"], ["--help"]])
    assert (version.status, text.status) == (0, 0)
    assert version.out.startswith(f"{program} ")
    assert re.search(r"2 usage[^;0-9]* or an extra that is not installed", " ".join(text.out.split()))
    commands = COMMAND.findall(text.out)
    assert len(commands) >= 3
    for command, told in zip(commands, plain.run_all(module, [[one, "--help"] for one in commands]), strict=True):
        assert told.status == 0, command
        assert told.out.startswith(f"Usage: {program} {command} "), command
        assert told.err == "", command


def test_every_program_starts_as_a_module(plain: PlainInstall) -> None:
    for program, module in PROGRAMS.items():
        started = plain.run("-m", module.removesuffix(".cli"), "--version")
        assert (started.status, started.err) == (0, ""), program


def test_every_command_of_the_backend_says_what_to_install(plain: PlainInstall, tmp_path: Path) -> None:
    (text,) = plain.run_all("fleet_backend.cli", [["--help"]])
    more = {"trend": ["car1", "2"], "fill": ["car1", "oil"], "ingest": ["--broker", "mqtt://127.0.0.1"]}
    more |= {"retain": ["--months", "12"], "forget": ["car1"]}
    commands = [one for one in COMMAND.findall(text.out) if one != "follow"]
    database = ["--database", f"sqlite:///{tmp_path}/fleet.sqlite"]
    told = plain.run_all("fleet_backend.cli", [[one, *database, *more.get(one, [])] for one in commands])
    assert [outcome.status for outcome in told] == [2] * len(commands)
    for command, outcome in zip(commands, told, strict=True):
        one_line("fleet-backend", "page" if command in {"serve", "watch"} else "fleet", outcome.err)
    assert list(tmp_path.iterdir()) == []


def test_a_broker_is_followed_without_an_extra(plain: PlainInstall) -> None:
    (told,) = plain.run_all("fleet_backend.cli", [["follow", f"mqtt://127.0.0.1:{free_port()}"]])
    assert (told.status, "error: broker 127.0.0.1:" in told.err) == (3, True)


def test_extras_are_asked_for_at_once(plain: PlainInstall, tmp_path: Path) -> None:
    package = tmp_path / "car.pdx"
    database = ["--database", "sqlite:///fleet.sqlite"]
    runs = {
        "page": ["serve", *database],
        "nats": ["ingest", *database, "--broker", "nats://127.0.0.1"],
    }
    told = plain.run_all("fleet_backend.cli", list(runs.values()), cwd=tmp_path)
    for extras, outcome in zip(runs, told, strict=True):
        one_line("fleet-backend", extras, outcome.err)
    words = ["dtc", "-i", "virtual", "-c", "x", "--active", "--description", str(package)]
    (asked,) = plain.run_all("diag_service.cli", [words], cwd=tmp_path)
    one_line("diag-service", "odx,uds", asked.err)


def test_a_pdx_says_what_to_install(plain: PlainInstall, tmp_path: Path) -> None:
    (told,) = plain.run_all("ecu_emulator.cli", [["pdx", "-o", str(tmp_path / "tcu.pdx")]])
    assert told.status == 2
    one_line("ecu-emulator", "odx", told.err)
    assert list(tmp_path.iterdir()) == []


def test_parquet_and_mf4_say_what_to_install(plain: PlainInstall, tmp_path: Path) -> None:
    log, mdf = tmp_path / "drive.log", tmp_path / "drive.mf4"
    log.write_text(CANDUMP, encoding="utf-8")
    mdf.write_bytes(MDF)
    runs: dict[str, list[list[str | Path]]] = {
        "parquet": [
            ["decode", log, "-o", "d.parquet"],
            ["decode", log, "-o", "-"],
            ["analyze", log, "-o", "a.parquet"],
        ],
        "cluster": [
            ["lake", "check", tmp_path],
            ["analyze", tmp_path, "--lake", tmp_path / "lake"],
        ],
        "mf4": [
            ["inspect", mdf],
            ["signals", mdf],
            ["analyze", mdf],
            ["calibrate", mdf, "-o", "c.toml"],
        ],
    }
    asked = [(extra, [str(word) for word in words]) for extra, all_words in runs.items() for words in all_words]
    told = plain.run_all("diag_service.cli", [words for _, words in asked], cwd=tmp_path)
    for (extra, words), outcome in zip(asked, told, strict=True):
        assert outcome.status == 2, (words, outcome)
        one_line("diag-service", extra, outcome.err.splitlines(keepends=True)[-1])
        assert "Traceback" not in outcome.err


def test_a_folder_goes_on_without_the_logs_that_need_an_extra(plain: PlainInstall, tmp_path: Path) -> None:
    (tmp_path / "drive.mf4").write_bytes(MDF)
    (told,) = plain.run_all("diag_service.cli", [["analyze", str(tmp_path), "--jobs", "1"]], cwd=tmp_path)
    assert told.status == 3
    assert "drive.mf4: not read: " in told.out
    assert "pip install '.[mf4]'" in told.err


def test_a_log_in_mf4_says_what_to_install(plain: PlainInstall, tmp_path: Path) -> None:
    (told,) = plain.run_all("ecu_emulator.cli", [["record", str(tmp_path / "drive.mf4")]])
    assert told.status == 2
    one_line("ecu-emulator", "mf4", told.err)
    assert list(tmp_path.iterdir()) == []


def test_the_rest_works_without_extras(plain: PlainInstall, tmp_path: Path) -> None:
    log = tmp_path / "drive.log"
    log.write_text(CANDUMP, encoding="utf-8")
    runs = [["inspect", str(log)], ["signals", str(log)], ["analyze", str(log)], ["config", "check"]]
    assert [outcome.status for outcome in plain.run_all("diag_service.cli", runs, cwd=tmp_path)] == [0] * len(runs)
    (listed,) = plain.run_all("ecu_emulator.cli", [["scenarios"]])
    assert listed.status == 0


@pytest.mark.parametrize(("module", "program"), [("demo", "demo"), ("demo.fleet", "fleet")])
def test_the_demonstrations_say_what_to_install(plain: PlainInstall, tmp_path: Path, module: str, program: str) -> None:
    assert plain.run("-m", module, "--help").status == 0
    told = plain.run("-m", module, "--output", str(tmp_path / "output"))
    assert told.status == 2
    one_line(program, "[a-z,]+", told.err)
    assert list(tmp_path.iterdir()) == []


def test_a_plain_install_is_no_larger_than_it_was_said_to_be() -> None:
    """Count what pip has put on the disk for the requirements without extras."""
    sizes = {
        name: sum(
            one.stat().st_size for path in distribution(name).files or () if (one := Path(str(path.locate()))).is_file()
        )
        for name in core_distributions()
    }
    assert sum(sizes.values()) < 480e6, sizes


def test_python_says_what_to_install(plain: PlainInstall, tmp_path: Path) -> None:
    (tmp_path / "drive.log").write_text(CANDUMP, encoding="utf-8")
    program = """
import diag_service, ecu_emulator
for package in (diag_service, ecu_emulator):
    for name in package.__all__:
        getattr(package, name)
analysis, log = diag_service.analyze("drive.log"), diag_service.read("drive.log")
for wanted in (
    analysis.shifts.to_arrow, analysis.shifts.to_pandas, analysis.clutches.to_polars, log.to_arrow,
    lambda: ecu_emulator.Emulator().record("drive.mf4"),
    diag_service.UdsTester(interface="virtual", channel="1", is_active=True).__enter__,
    lambda: diag_service.scan_controllers(interface="virtual", channel="1", is_active=True),
):
    try:
        wanted()
    except (diag_service.ExtraMissingError, ecu_emulator.ExtraMissingError) as error:
        print(str(error).rpartition("pip install ")[2])
"""
    told = plain.run("-c", program, cwd=tmp_path)
    extras = ["parquet", None, None, "parquet", "mf4", "uds", "uds"]
    names = ["", "pandas", "polars", "", "", "", ""]
    wanted = [f"'.[{extra}]' in the checkout" if extra else name for extra, name in zip(extras, names, strict=True)]
    assert told.out.splitlines() == wanted, told.err
