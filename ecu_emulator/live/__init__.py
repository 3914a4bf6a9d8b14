"""A drive on a bus in real time."""
