"""The softplc command: thin commands over app."""
