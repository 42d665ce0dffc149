"""Which form of the kernel an observer is stepped by: numpy, or compiled before the first scan."""

import structlog

from softplc.app.isolating import IsolatingObserver
from softplc.app.layout import ObserverLayout
from softplc.clock import Clock
from softplc.config.models import KernelChoice
from softplc.errors import ConfigError
from softplc.interfaces import Observer
from softplc.kernel.compiled import available
from softplc.observers.aoi import AoiConfig

WORTH_COMPILING = 10_000
"""Axes of one observer from which `auto` compiles. Below, 0.1 ms of a scan at most are gained, for a second and
90 MiB at every start."""

log = structlog.get_logger(__name__)


def build_observer(layout: ObserverLayout, choice: KernelChoice, clock: Clock) -> Observer:
    """The observer of these axes, ready for its first scan: what is compiled is compiled here.

    Where numba does not load, `compiled` is a ConfigError, and `auto` a warning.
    """
    places, configs = layout.places, layout.configs
    plain = type(configs[0]).build
    wanted = choice == "compiled" or (choice == "auto" and len(places) >= WORTH_COMPILING and available())
    if not isinstance(configs[0], AoiConfig) or not wanted:
        return IsolatingObserver(places, configs, plain)

    began = clock.monotonic()
    try:
        from softplc.kernel.compiled import aoi as compiled  # noqa: PLC0415  # imports numba
    except (ImportError, OSError) as error:  # OSError: memory may not be made executable
        cure = "pip install 'softplc[compiled]'; under systemd see MemoryDenyWriteExecute in docs/observers.md"
        if choice == "compiled":
            raise ConfigError(
                f"realtime.kernel: compiled needs numba, which does not load: {error} ({cure})"
            ) from error
        log.warning("kernel not compiled, numpy does its work", reason=str(error), cure=cure)
        return IsolatingObserver(places, configs, plain)
    from_cache = compiled.prepare("f4" if configs[0].precision == "real" else "f8")
    log.info(
        "compiled kernel ready",
        axes=len(places),
        seconds=round(clock.monotonic() - began, 2),
        compiled="by an earlier start" if from_cache else "now",
    )
    return IsolatingObserver(places, configs, lambda places, configs: AoiConfig.build(places, configs, compiled.step))
