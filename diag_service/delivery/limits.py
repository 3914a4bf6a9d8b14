"""How long delivery waits for whom, and how much it holds."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class DeliveryLimits:
    """Times and counts of an outbox; what stands here suits a vehicle on a mobile link."""

    first_pause_s: float = 0.5  # after a connection broke; doubled with each further failure
    longest_pause_s: float = 30.0
    restart_pause_s: float = 1.0  # after the sending itself failed, which it should not
    settled_after_s: float = 5.0  # then a result that a broker acknowledged is taken to be where it belongs
    resend_after_s: float = 5.0  # without a receipt
    longest_resend_s: float = 30.0  # while all is silent a few are sent again, less and less often up to this
    astray_after_s: float = 2.0  # what was sent so long before an acknowledged one was lost on its way, not delayed
    backlog_lag_s: float = 2.0  # so far behind a backend may be before it gets more of the backlog
    window_count: int = 2000  # results that a backend may owe us a receipt for
    probe_count: int = 20  # results that ask a silent backend whether it is there; the others wait for its word
