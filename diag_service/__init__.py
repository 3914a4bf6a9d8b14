"""The diagnostic service: reads frames, finds shifts, estimates friction, judges the fluid, stores and publishes."""

from canlog.errors import SourceError
from diag_service.errors import ConfigError, DiagServiceError, PublishError, ResultError, StoreError

__all__ = ["ConfigError", "DiagServiceError", "PublishError", "ResultError", "SourceError", "StoreError"]
