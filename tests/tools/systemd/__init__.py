"""A systemd of the tests' own, in namespaces of its own, that runs the shipped unit and nothing else."""
