"""Writes what a clutch's state takes over from a verdict into its JSON Schema: ``python -m tests.tools.clutch_schema``.

The verdict on a shift and the retained state of its clutch say the same of the clutch. People describe it once, in the
schema of a shift.
"""

import json
import re
from typing import Any

from fleet_contract import Channel, schema
from fleet_contract.schema_check import SCHEMA_FOLDER


def clutch_schema() -> dict[str, Any]:
    """Return the schema of a clutch's state, with all that a verdict says as the schema of a shift describes it."""
    shift: dict[str, Any] = schema(Channel.SHIFT.label)
    clutch: dict[str, Any] = schema(Channel.CLUTCH.label)
    defined = shift["$defs"]
    properties = clutch["properties"] | defined["verdict"]["properties"]
    used = re.findall(r"#/\$defs/(\w+)", json.dumps(properties))
    return clutch | {"properties": properties, "$defs": {name: defined[name] for name in defined if name in used}}


if __name__ == "__main__":
    text = json.dumps(clutch_schema(), indent=2, ensure_ascii=False)
    (SCHEMA_FOLDER / "clutch-v1.json").write_text(text + "\n", encoding="utf-8")
