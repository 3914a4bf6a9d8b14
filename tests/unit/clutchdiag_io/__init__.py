"""Unit tests of what every program does at the edge of its machine."""
