"""The batch kernels compiled with numba: bit-equal to numpy, faster, and needing the extra `compiled`.

    pip install 'softplc[compiled]'

Importing this package imports no numba; importing `softplc.kernel.compiled.aoi` does (0.5 s, 90 MiB).
"""

from importlib.util import find_spec


def available() -> bool:
    """Whether numba is installed. It is not imported, so a broken installation is found later."""
    return find_spec("numba") is not None
