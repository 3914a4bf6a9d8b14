"""What the emulated controller answers to testers: UDS (ISO 14229-1) as pure functions over a table, and transport."""
