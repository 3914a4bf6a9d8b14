"""Settings from one TOML file and the environment: what stands for options that the command line does not name.

Imported only where a file or a variable asks for it: pydantic takes a moment that a plain start does without.
"""

from pathlib import Path
from typing import Any, Literal
from urllib.parse import urlsplit

from pydantic import SecretStr, ValidationError
from pydantic_settings import BaseSettings, PydanticBaseSettingsSource, SettingsConfigDict

from canlog.plain_files import read_toml_file
from diag_service.delivery.tls import check_secret_mode
from diag_service.errors import ConfigError
from diag_service.settings.defaults import PREFIX, OptionValue


class Settings(BaseSettings):
    """Every option that can be set; a name is that of the option, with ``_`` for ``-``."""

    model_config = SettingsConfigDict(env_prefix=PREFIX, extra="forbid", frozen=True, env_ignore_empty=True)

    vehicle: str | None = None
    dbc: Path | None = None
    lenient: bool | None = None
    profile: Path | None = None
    calibration: Path | None = None
    store: Path | None = None
    store_budget: int | None = None  # MiB
    broker: SecretStr | None = None  # a URL may hold a password
    ca: Path | None = None
    cert: Path | None = None
    key: Path | None = None
    password_file: Path | None = None
    acknowledge: Literal["broker", "backend"] | None = None
    interface: str | None = None
    channel: str | None = None
    bitrate: int | None = None
    fd: bool | None = None
    only_mapped: bool | None = None
    duration: float | None = None
    metrics: str | None = None

    @classmethod
    def settings_customise_sources(
        cls,
        settings_cls: type[BaseSettings],
        init_settings: PydanticBaseSettingsSource,
        env_settings: PydanticBaseSettingsSource,
        dotenv_settings: PydanticBaseSettingsSource,
        file_secret_settings: PydanticBaseSettingsSource,
    ) -> tuple[PydanticBaseSettingsSource, ...]:
        """Let the environment stand over the file; ``.env`` files and secret folders do not count."""
        del settings_cls, dotenv_settings, file_secret_settings
        return env_settings, init_settings


def load_settings(file: Path | None) -> dict[str, OptionValue]:
    """Return what a file, if one is named, and the environment set, as the command line's own values.

    Raises
    ------
    ConfigError
        If a key is unknown, a value unfit, or a file with a password may be read by others. The message does not repeat
        values, which may be secret.
    """
    table = {} if file is None else _read(file)
    try:
        settings = Settings(**table)
    except ValidationError as exc:
        problems = [f"{'.'.join(map(str, error['loc']))}: {error['msg']}" for error in exc.errors(include_input=False)]
        raise ConfigError(f"settings{'' if file is None else f' in {file}'}: {'; '.join(problems)}") from None
    values = {name: getattr(settings, name) for name in Settings.model_fields}
    return {
        name: value.get_secret_value() if isinstance(value, SecretStr) else value
        for name, value in values.items()
        if value is not None
    }


def _read(file: Path) -> dict[str, Any]:
    try:
        table = read_toml_file(file)
    except OSError as exc:
        raise ConfigError(f"cannot read {file}: {exc.strerror or exc}") from exc
    except ValueError as exc:
        raise ConfigError(f"{file} is no TOML: {exc}") from exc
    if "@" in str(table.get("broker", "")) and urlsplit(str(table["broker"])).password is not None:
        check_secret_mode(file)
    return table
