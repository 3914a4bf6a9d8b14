"""Diagnosis over IP (ISO 13400-2): messages and state machines as pure functions, and the server around them."""
