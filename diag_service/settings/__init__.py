"""What a user can set: by option, environment or file, checked once."""
