"""Whether the data of a shift can be believed."""
