"""Tests of the interface silkit: participants as processes, a registry on loopback."""
