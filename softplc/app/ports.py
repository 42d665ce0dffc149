"""Are the ports free that are to be listened on?"""

import errno
import socket

from softplc.config.models import Config
from softplc.errors import SoftplcError


def check_ports(config: Config) -> None:
    """Fail before anything starts when a port that is to be listened on is taken. Raises SoftplcError."""
    for publisher in config.publishers:
        if not port_is_free(publisher.host, publisher.port):
            raise SoftplcError(
                f"{publisher.host}:{publisher.port} for the {publisher.type} server is in use; "
                f"end what listens there or choose another port"
            )


def port_is_free(host: str, port: int) -> bool:
    """False when somebody listens on the port now; what else stands against listening, the server will say."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with socket.socket(family, socket.SOCK_STREAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except OSError as error:
            return error.errno != errno.EADDRINUSE
    return True
