"""The table of a controller as a PDX package: ODX 2.2 (ISO 22901-1), what diagnostic tools read."""
