"""The softplc command: thin commands over app."""


def main() -> int:
    """Run the command line; returns the exit code. Imports the commands only now, so that child processes do not."""
    from softplc.cli.commands import run_command_line  # noqa: PLC0415

    return run_command_line()
