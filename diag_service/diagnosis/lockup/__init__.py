"""The lock-up clutch of a torque converter: its friction from hours of small slip, and whether it shudders."""
