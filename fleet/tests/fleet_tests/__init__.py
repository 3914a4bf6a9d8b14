"""Unit tests of the fleet backend."""
