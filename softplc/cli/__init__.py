"""The softplc command: thin commands over app."""

import signal
import sys

_RUN_UNTIL_STOPPED = ("demo", "run", "emulate")  # for these Ctrl-C is the usual end


def main() -> int:
    """Run the command line; returns the exit code. Imports the commands only now, so that child processes do not."""
    try:
        from softplc.cli.commands import run_command_line  # noqa: PLC0415

        return run_command_line()
    except KeyboardInterrupt:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # a second one would come while the interpreter ends
        return 0 if sys.argv[1:2] and sys.argv[1] in _RUN_UNTIL_STOPPED else 130
