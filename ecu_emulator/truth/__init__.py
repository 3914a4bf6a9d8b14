"""What only the emulator knows, for tests and demonstrations."""
