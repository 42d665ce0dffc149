"""Builds and runs the processes: supervisor, scan process, gateway."""
