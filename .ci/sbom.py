"""Writes the bill of materials of requirements.lock as CycloneDX 1.6 JSON to standard output.

Standard library only: it states what the lock states, every package with its version and hashes, and nothing that it
does not know, such as licences or which package needs which.
"""

import json
import re
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[1]
PIN = re.compile(r"([a-z0-9][a-z0-9._-]*)==([^ ]+)( ; [^\\]+)? \\")
HASH = re.compile(r" {4}--hash=sha256:([0-9a-f]{64})(?: \\)?")


def components(lock: str) -> list[dict[str, object]]:
    """Return a component per package of a lock."""
    found: list[dict[str, object]] = []
    hashes: list[dict[str, str]] = []
    for line in lock.splitlines():
        if pin := PIN.fullmatch(line):
            name, version = pin[1], pin[2]
            hashes = []
            reference = f"pkg:pypi/{name}@{version}"
            found.append(
                {
                    "type": "library",
                    "bom-ref": reference,
                    "name": name,
                    "version": version,
                    "purl": reference,
                    "hashes": hashes,
                }
            )
        elif digest := HASH.fullmatch(line):
            hashes.append({"alg": "SHA-256", "content": digest[1]})
    return found


def bill() -> dict[str, object]:
    """Return the bill of materials of this project."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    name, version = project["name"], project["version"]
    return {
        "$schema": "http://cyclonedx.org/schema/bom-1.6.schema.json",
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
        "version": 1,
        "metadata": {
            "component": {
                "type": "application",
                "bom-ref": f"pkg:pypi/{name}@{version}",
                "name": name,
                "version": version,
                "licenses": [{"license": {"id": project["license"]}}],
            }
        },
        "components": components((ROOT / "requirements.lock").read_text(encoding="utf-8")),
    }


if __name__ == "__main__":
    json.dump(bill(), sys.stdout, indent=2)
    sys.stdout.write("\n")
