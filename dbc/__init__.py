"""The wire contract: the project's own database."""

from dbc.contract import DBC_PATH, load_contract

__all__ = ["DBC_PATH", "load_contract"]
