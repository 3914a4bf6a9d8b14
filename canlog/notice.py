"""A level of log messages between INFO and WARNING: always shown, nothing is wrong."""

NOTICE = 25
