"""Alarms of the fleet: rules that raise and clear them, tables that keep them, carriers that bring them to people."""
