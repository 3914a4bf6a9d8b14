"""The commands, loaded when they are called: functions of the options of the command line and of ``Controls``."""
