"""With which asyncua the fast path may be used."""

from softplc import asyncua_version


def proven() -> bool:
    """The server's fast path was compared with the installed asyncua."""
    return asyncua_version.proven("server")
