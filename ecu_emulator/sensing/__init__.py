"""What the vehicle measures, and how measuring goes wrong."""
