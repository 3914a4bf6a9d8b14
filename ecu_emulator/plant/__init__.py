"""The emulated vehicle: engine, hydraulics, wet dual clutch, driveline, road."""
