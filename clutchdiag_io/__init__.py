"""What every program does at the edge of its machine: command line, standard output, private files, signs of life."""
