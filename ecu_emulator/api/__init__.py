"""The Python interface: what the commands do, as an object that prints nothing (docs/python.md)."""
