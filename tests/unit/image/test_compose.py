"""Every service of docker-compose.yml says when it is well, what it may use and how much of its log is kept."""

import os
import re
import socket
import subprocess
import time
from importlib import import_module
from pathlib import Path

import pytest

from tests.support.image.compose import Service, read_compose
from tests.support.image.dockerfile import read_stages

ROOT = Path(__file__).parents[3]
COMPOSE = read_compose(ROOT / "docker-compose.yml")
SERVICES: dict[str, Service] = COMPOSE["services"]
OURS = {name: service for name, service in SERVICES.items() if "build" in service}
LAST = read_stages(ROOT / "Dockerfile")[-1]
EXACT = re.compile(r"[a-z0-9./-]+:v?\d+\.\d+(\.\d+)?(-[a-z0-9-]+)?")
MIB = {"M": 1, "G": 1024}


def each(services: dict[str, Service]) -> pytest.MarkDecorator:
    return pytest.mark.parametrize("service", services.values(), ids=services)


@each(SERVICES)
def test_it_has_a_health_check_or_ends_by_itself(service: Service) -> None:
    check = service["healthcheck"]
    if check.get("disable"):
        assert service["restart"] == "no"
        waiting = [other for other in SERVICES.values() if service is not other and "depends_on" in other]
        name = next(key for key, value in SERVICES.items() if value is service)
        conditions = {other["depends_on"][name]["condition"] for other in waiting if name in other["depends_on"]}
        assert conditions == {"service_completed_successfully"}
        return
    assert check["test"][0] in {"CMD", "CMD-SHELL"}
    assert {"interval", "timeout", "retries"} <= set(check)


@each(SERVICES)
def test_it_has_limits(service: Service) -> None:
    limits = service["deploy"]["resources"]["limits"]
    size = re.fullmatch(r"(\d+)([MG])", limits["memory"])
    assert size is not None
    assert 64 <= int(size[1]) * MIB[size[2]] <= 2048
    assert 0.0 < float(limits["cpus"]) <= 1.0  # an engine refuses more than the host has
    assert 16 <= limits["pids"] <= 1024


@each(SERVICES)
def test_its_log_is_bounded(service: Service) -> None:
    assert service["logging"]["driver"] == "json-file"
    options = service["logging"]["options"]
    assert re.fullmatch(r"\d+m", options["max-size"])
    assert 1 <= int(options["max-file"]) <= 10


def test_images_have_exact_tags() -> None:
    images = [service["image"] for service in SERVICES.values()]
    images += [stage.image for stage in read_stages(ROOT / "Dockerfile")]
    assert [name for name in images if EXACT.fullmatch(name) is None] == []


def test_compiled_kernels_outlive_the_containers_that_use_them() -> None:
    folder = LAST.environment["NUMBA_CACHE_DIR"]
    for name in ("service", "emulator"):
        mounts = dict(volume.split(":") for volume in SERVICES[name]["volumes"])
        (volume,) = [source for source, target in mounts.items() if target == folder]
        assert volume in COMPOSE["volumes"]


def test_results_are_kept_where_the_image_writes_them() -> None:
    targets = [volume.split(":")[1] for volume in SERVICES["service"]["volumes"]]
    assert f"{LAST.environment['XDG_STATE_HOME']}/clutchdiag" in targets


@each(OURS)
def test_its_command_is_understood(service: Service, capsys: pytest.CaptureFixture[str]) -> None:
    program, command, *words = service["command"]
    main = import_module(f"{program.replace('-', '_')}.cli").main
    with pytest.raises(SystemExit) as ended:
        main([command, "--help"])
    assert ended.value.code == 0
    known = set(re.findall(r"(?<![\w-])--?[a-z][a-z-]*", capsys.readouterr().out))
    assert {word for word in words if word.startswith("-")} - known == set()


@pytest.mark.parametrize(("age_s", "is_well"), [(0.0, True), (20.0, True), (60.0, False), (None, False)])
@pytest.mark.parametrize("name", ["emulator", "ingest"])
def test_a_file_that_grows_old_is_not_well(name: str, age_s: float | None, tmp_path: Path, *, is_well: bool) -> None:
    kind, text = SERVICES[name]["healthcheck"]["test"]
    assert kind == "CMD-SHELL"
    inside = SERVICES[name]["command"][SERVICES[name]["command"].index("--alive") + 1]
    assert inside in text
    path = tmp_path / "alive"
    if age_s is not None:
        path.touch()
        os.utime(path, (time.time() - age_s,) * 2)
    done = subprocess.run(["/bin/sh", "-c", text.replace(inside, str(path))], capture_output=True, check=False)
    assert (done.returncode == 0) == is_well


def said_by(name: str, folder: Path, *, replaced: dict[str, str], **environment: str) -> tuple[int, str]:
    """Run the script of a service, with a stand-in for mosquitto that tells its configuration."""
    *shell, script = SERVICES[name]["command"]
    assert shell == ["sh", "-c"]
    stand_in = folder / "mosquitto"
    stand_in.write_text('#!/bin/sh\ncat "$2"\n', encoding="utf-8")
    stand_in.chmod(0o755)
    for old, new in replaced.items():
        assert old in script
        script = script.replace(old, new)
    variables = {"PATH": f"{folder}:{os.environ['PATH']}", **environment}
    done = subprocess.run(["/bin/sh", "-c", script], capture_output=True, text=True, check=False, env=variables)
    return done.returncode, done.stdout + done.stderr


def test_a_port_that_is_taken_is_told(tmp_path: Path) -> None:
    config = {"/tmp/fleet.conf": str(tmp_path / "fleet.conf")}  # noqa: S108 - of the container
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        port = str(other.getsockname()[1])
        other.listen()
        status, said = said_by("broker", tmp_path, replaced=config, BROKER_PORT=port)
        assert (status, f"Port {port} is taken" in said, "BROKER_PORT=1885" in said) == (1, True, True)
    status, said = said_by("broker", tmp_path, replaced=config, BROKER_PORT=port)
    assert (status, said.splitlines()[0]) == (0, f"listener {port} 127.0.0.1")


def test_a_bus_that_is_not_there_is_told_after_a_stated_wait(tmp_path: Path) -> None:
    there = {"/sys/class/net/vcan0": str(tmp_path)}
    assert said_by("bus", tmp_path, replaced=there) == (0, "")
    missing = {"/sys/class/net/vcan0": str(tmp_path / "none"), "sleep 1": "true"}
    status, said = said_by("bus", tmp_path, replaced=missing)
    assert status == 1
    first, *_, last = said.splitlines()
    assert first == "Waiting for vcan0, 60 s more at most."
    assert last.startswith("There is no vcan0 after 60 s: sudo modprobe vcan")
    assert SERVICES["service"]["depends_on"]["bus"] == {"condition": "service_completed_successfully"}
    assert SERVICES["emulator"]["depends_on"] == {"service": {"condition": "service_healthy"}}


def test_the_image_runs_as_a_number_that_is_not_root() -> None:
    (user,) = [entry.text for entry in LAST.instructions if entry.name == "USER"]
    assert re.fullmatch(r"[1-9]\d*:[1-9]\d*", user)
    (made,) = [entry.text for entry in LAST.instructions if entry.name == "RUN" and "useradd" in entry.text]
    assert f"--uid {user.partition(':')[0]} " in made
