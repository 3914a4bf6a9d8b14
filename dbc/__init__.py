"""The wire contract: the project's own database."""

from dbc.contract import DBC_PATH, dbc_path, load_contract

__all__ = ["DBC_PATH", "dbc_path", "load_contract"]
