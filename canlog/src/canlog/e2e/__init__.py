"""Which frames may be believed: length, CRC, alive counter, AUTOSAR E2E states, what a controller reports."""
