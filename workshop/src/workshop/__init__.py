"""Both ends of diagnostics by UDS (ISO 14229): a tester that asks controllers, an emulated controller that answers.

What is named here is imported when it is first used, and prints nothing (docs/python.md).
"""

import typing

from canlog.extras import on_demand as _on_demand

if typing.TYPE_CHECKING:
    from workshop.controller.answers import Answers
    from workshop.tester.uds_tester import UdsTester, scan_controllers

__all__ = ["Answers", "UdsTester", "scan_controllers"]

__getattr__, __dir__ = _on_demand(__name__, __file__)
