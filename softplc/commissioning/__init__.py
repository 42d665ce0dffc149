"""Looks at observers and recordings in peace: works on files, needs no server."""
