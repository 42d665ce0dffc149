"""The real-time options of the scan process; each that is not permitted is one clear warning and nothing more."""

import ctypes
import os
import sys

import structlog

from softplc.config.models import RealTime

_MCL_CURRENT, _MCL_FUTURE = 1, 2

log = structlog.get_logger(__name__)


def apply_realtime(options: RealTime) -> None:
    """Apply what the configuration asks for to this process."""
    if options.cpu_affinity is not None:
        _set_affinity(options.cpu_affinity)
    if options.fifo_priority is not None:
        _set_fifo(options.fifo_priority)
    if options.lock_memory:
        _lock_memory()


def _set_affinity(cpus: tuple[int, ...]) -> None:
    if not hasattr(os, "sched_setaffinity"):
        _refused("cpu_affinity", f"not available on {sys.platform}", "leave it out")
        return
    try:
        os.sched_setaffinity(0, cpus)
    except OSError as error:
        have = ", ".join(str(cpu) for cpu in sorted(os.sched_getaffinity(0)))
        _refused("cpu_affinity", str(error), f"choose among the CPUs {have}")


def _set_fifo(priority: int) -> None:
    if not hasattr(os, "sched_setscheduler"):
        _refused("fifo_priority", f"not available on {sys.platform}", "leave it out")
        return
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except OSError as error:
        _refused("fifo_priority", str(error), "give the service CAP_SYS_NICE or LimitRTPRIO")


def _lock_memory() -> None:
    libc = ctypes.CDLL(None, use_errno=True)
    if not hasattr(libc, "mlockall"):
        _refused("lock_memory", f"not available on {sys.platform}", "leave it out")
    elif libc.mlockall(_MCL_CURRENT | _MCL_FUTURE) != 0:
        reason = os.strerror(ctypes.get_errno())
        _refused("lock_memory", reason, "give the service CAP_IPC_LOCK or a larger LimitMEMLOCK")


def _refused(option: str, reason: str, cure: str) -> None:
    log.warning("real-time option not applied", option=f"realtime.{option}", reason=reason, cure=cure)
