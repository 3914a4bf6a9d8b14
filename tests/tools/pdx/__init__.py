"""Makes a PDX package (ODX 2.2) of a controller's table."""
