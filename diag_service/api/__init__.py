"""The Python interface: what the commands do, as functions and objects that print nothing (docs/python.md)."""
