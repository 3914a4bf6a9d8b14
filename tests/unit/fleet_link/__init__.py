"""Unit tests of the way to a broker."""
