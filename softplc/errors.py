"""Every error that softplc raises on purpose, as one tree, each with its exit code.

```
SoftplcError                 exit 1   something failed; the text says what and what would be right
├── ConfigError              exit 78  the configuration is wrong (EX_CONFIG)
├── UsageError               exit 2   the command line is wrong
└── LinkError                exit 69  a source cannot be reached or does not speak as agreed (EX_UNAVAILABLE)
```

Errors are for start-up and for drivers; while the scan runs, a fault is a StatusCode on a tag.
"""


class SoftplcError(Exception):
    """Something failed; the text says what, and what would be right."""

    exit_code = 1


class UsageError(SoftplcError):
    """The command line asks for something that cannot be done."""

    exit_code = 2


class ConfigError(SoftplcError):
    """The configuration is wrong: one line per error, each with its place.

    `lines` are complete messages, `file:line:column: path: what was found, what would be right`.
    """

    exit_code = 78

    def __init__(self, *lines: str) -> None:
        super().__init__("\n".join(lines))
        self.lines = lines


class LinkError(SoftplcError):
    """A source cannot be reached, went silent, or answered against the protocol.

    A driver raises this from open, read and write; the link that hosts the driver turns it into a
    status on every tag of the source, closes the driver and tries again with a new one.
    """

    exit_code = 69
