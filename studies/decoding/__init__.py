"""What the decoding benchmark decodes."""
