"""The arithmetic of the observers: no clock, no log, no I/O."""
