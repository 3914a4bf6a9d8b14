"""CAN logs, live buses and message databases: bytes or sockets to frames, frames to protected, decoded columns."""
