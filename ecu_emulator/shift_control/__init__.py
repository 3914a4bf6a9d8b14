"""Shift control at 1 kHz: the controller's state and laws, the workshop routine, touch points."""
