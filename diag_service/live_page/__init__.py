"""The page of a live run: how the bus is, both clutches, the last shifts; for browsers on the same machine."""

from diag_service.live_page.server import opened_page

__all__ = ["opened_page"]
