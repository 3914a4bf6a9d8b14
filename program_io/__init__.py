"""What every program does at the edge of its machine: standard output, files for its owner, signs of life."""
