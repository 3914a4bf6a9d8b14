"""What is on a bus: databases, profiles and addresses of messages, and what they suffice for."""
