"""The commands, a module each, loaded when they are called: ``execute(options, stop, counts_wanted)``."""
