"""What works in a configuration, but not as one would wish: no error, but worth a sentence at its start."""

from softplc.config.models import Config


def remarks(config: Config) -> list[str]:
    """One text for each remark, with the name of its axis."""
    return [
        f"{axis.name}: {text}"
        for axis in config.axes
        if hasattr(axis.observer, "remarks")  # few observers have any to make
        for text in axis.observer.remarks(axis.range)
    ]
