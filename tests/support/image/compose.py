"""docker-compose.yml as docker compose reads it: merge keys resolved, ``$$`` a dollar sign."""

from pathlib import Path
from typing import Any

from ruamel.yaml import YAML

Service = dict[str, Any]


def read_compose(path: Path) -> dict[str, Any]:
    """Return the file's content."""
    content: dict[str, Any] = _plain(YAML(typ="safe", pure=True).load(path.read_text(encoding="utf-8")))
    return content


def _plain(value: Any) -> Any:  # noqa: ANN401 - parsed YAML
    if isinstance(value, dict):
        return {key: _plain(entry) for key, entry in value.items()}
    if isinstance(value, list):
        return [_plain(entry) for entry in value]
    return value.replace("$$", "$") if isinstance(value, str) else value
