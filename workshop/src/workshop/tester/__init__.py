"""A diagnostic tester: asks controllers by UDS (ISO 14229) what they know, on CAN or over IP."""
