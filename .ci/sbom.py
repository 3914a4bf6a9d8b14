"""Writes a bill of materials as CycloneDX 1.6 JSON to standard output.

Without an argument it states what requirements.lock states: every package with its version and hashes, and nothing that
the lock does not know. With ``--run-time`` it states what the project as it is installed here needs to run, extras
left out: the packages, the licence that each names, and which needs which.

Standard library only, but for reading requirements: that is done by ``packaging``, which every pip brings along.
"""

import argparse
import json
import re
import sys
import tomllib
from collections.abc import Iterable
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
PIN = re.compile(r"([a-z0-9][a-z0-9._-]*)==([^ ]+)( ; [^\\]+)? \\")
HASH = re.compile(r" {4}--hash=sha256:([0-9a-f]{64})(?: \\)?")
LONGEST_NAME = 60  # of a licence; some packages put the whole text there
LICENCE_CLASS = "License :: "


def locked(lock: str) -> list[dict[str, object]]:
    """Return a component per package of a lock."""
    found: list[dict[str, object]] = []
    hashes: list[dict[str, str]] = []
    for line in lock.splitlines():
        if pin := PIN.fullmatch(line):
            hashes = []
            found.append({**_component(pin[1], pin[2]), "hashes": hashes})
        elif digest := HASH.fullmatch(line):
            hashes.append({"alg": "SHA-256", "content": digest[1]})
    return found


def needed(requirements: Iterable[str]) -> dict[str, tuple[Distribution, list[str]]]:
    """Return installed distributions and all that they need to run: each with the names that it needs itself."""
    found: dict[str, tuple[Distribution, list[str]]] = {}
    waiting = _wanted(requirements, frozenset())
    while waiting:
        name, extras = waiting.pop()
        package = distribution(name)
        names = found.setdefault(name, (package, []))[1]
        for wanted, its_extras in _wanted(package.requires or (), extras):
            if wanted not in names:
                names.append(wanted)
                waiting.append((wanted, its_extras))
    return found


def licence_of(package: Distribution) -> dict[str, object]:
    """Return the licence that a package names: an SPDX expression where it has one, else its name."""
    metadata = package.metadata
    if expression := metadata.get("License-Expression"):
        return {"licenses": [{"expression": expression}]}
    classes = [
        one.rpartition(" :: ")[2] for one in metadata.get_all("Classifier") or () if one.startswith(LICENCE_CLASS)
    ]
    text = " ".join((metadata.get("License") or "").split())
    names = [text] if 0 < len(text) <= LONGEST_NAME else classes
    return {"licenses": [{"license": {"name": name}} for name in names]} if names else {}


def normal(name: str) -> str:
    """Return the name of a distribution as indices spell it."""
    return re.sub(r"[-_.]+", "-", name).lower()


def run_time_bill() -> dict[str, object]:
    project = _project()
    own = distribution(project["name"]).requires or ()
    parts = needed(own)
    components = [
        {**_component(name, package.version), **licence_of(package)} for name, (package, _) in sorted(parts.items())
    ]
    references = {name: _component(name, package.version)["bom-ref"] for name, (package, _) in parts.items()}
    owners = {f"pkg:pypi/{project['name']}@{project['version']}": [name for name, _ in _wanted(own, frozenset())]}
    owners |= {str(references[name]): names for name, (_, names) in sorted(parts.items())}
    return {
        **_head(project),
        "components": components,
        "dependencies": [
            {"ref": owner, "dependsOn": sorted(str(references[name]) for name in names)}
            for owner, names in owners.items()
        ],
    }


def locked_bill() -> dict[str, object]:
    return {**_head(_project()), "components": locked((ROOT / "requirements.lock").read_text(encoding="utf-8"))}


def _wanted(requirements: Iterable[str], extras: frozenset[str]) -> list[tuple[str, frozenset[str]]]:
    """Return the names in some requirements that hold on this system, and with which extras."""
    from packaging.requirements import Requirement  # noqa: PLC0415 - the other bill does without

    found = []
    for text in requirements:
        one = Requirement(text)
        if one.marker is None or any(one.marker.evaluate({"extra": extra}) for extra in ("", *extras)):
            found.append((normal(one.name), frozenset(one.extras)))
    return found


def _component(name: str, version: str) -> dict[str, object]:
    reference = f"pkg:pypi/{name}@{version}"
    return {"type": "library", "bom-ref": reference, "name": name, "version": version, "purl": reference}


def _project() -> dict[str, Any]:
    project: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    return project


def _head(project: dict[str, Any]) -> dict[str, object]:
    own = {**_component(project["name"], project["version"]), "type": "application"}
    del own["purl"]
    return {
        "$schema": "http://cyclonedx.org/schema/bom-1.6.schema.json",
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
        "version": 1,
        "metadata": {"component": {**own, "licenses": [{"license": {"id": project["license"]}}]}},
    }


def main() -> None:
    """Write the bill that was asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--run-time", action="store_true", help="what is installed here and needed to run, with licences"
    )
    options = parser.parse_args()
    try:
        bill = run_time_bill() if options.run_time else locked_bill()
    except PackageNotFoundError as exc:
        sys.exit(f"{exc.name} is not installed here: make setup")
    json.dump(bill, sys.stdout, indent=2)
    sys.stdout.write("\n")


if __name__ == "__main__":
    main()
