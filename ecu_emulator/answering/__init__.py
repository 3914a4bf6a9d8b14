"""The emulated transmission answers testers while it drives."""
