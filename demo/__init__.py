"""The demonstration: emulator and service as two processes on one bus, judged by what a subscriber of MQTT received."""
