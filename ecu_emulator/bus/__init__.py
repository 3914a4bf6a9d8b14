"""Readings become frames, frames go wrong as asked, and onto a bus in real time."""
