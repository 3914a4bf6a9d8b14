"""Message databases: DBC, KCD, ARXML and SYM files, parsed within limits, and which frame is which message."""
