"""The wheels that ``make wheels`` builds, made once per run, for all of its workers, and put into environments."""

import fcntl
import os
import shutil
import subprocess
import sys
from pathlib import Path

from tests.support.distributions import FOLDERS, ROOT
from tests.support.plain_install import PlainInstall


def uv(*words: str | Path) -> None:
    """Have uv, which is as pip and quicker, fetch nothing."""
    command = [sys.executable, "-m", "uv", *words, "--quiet", "--offline", "--no-cache"]
    environment = {**os.environ, "CLUTCHDIAG_RELEASE": "1"}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def built_wheels(shared_folder: Path) -> dict[str, Path]:
    """Build all from copies, as a release does: building leaves files beside the sources."""
    folder = shared_folder / "wheels"
    with folder.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not folder.exists():
            listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True)
            sources = shared_folder / "sources"
            for name in listed.stdout.splitlines():
                if (ROOT / name).is_file() and not name.startswith(("tests/", "benchmarks/", "docs/")):
                    (sources / name).parent.mkdir(parents=True, exist_ok=True)
                    shutil.copyfile(ROOT / name, sources / name)
            for place in FOLDERS.values():
                own = sources / place.relative_to(ROOT)
                uv("build", "--wheel", "--no-build-isolation", "--python", sys.executable, "-o", folder, own)
    return {name: next(folder.glob(f"{name.replace('-', '_')}-*.whl")) for name in FOLDERS}


def install(environment: Path, *wheels: Path) -> PlainInstall:
    """Install wheels into an environment, for a newer Python perhaps: can-silkit says on 3.11, too, what it needs."""
    python = environment / "bin" / "python"
    uv("pip", "install", "--python", python, "--python-version", "3.12", "--no-deps", "--no-index", *wheels)
    return PlainInstall(python=python)
