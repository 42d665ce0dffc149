"""What a client shows of itself to a server: application name and URI, user, certificate. Read once, at start."""

import socket
from dataclasses import dataclass
from typing import Final

from asyncua import Client, ua
from asyncua.crypto import security_policies
from asyncua.crypto.uacrypto import x509_from_der
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric.rsa import RSAPrivateKey

from softplc.certificates import application_uris, read_certificate, read_pair
from softplc.drivers.opcua.config import OpcUaSecurity, OpcUaUser
from softplc.errors import ConfigError

APPLICATION_NAME: Final = "softplc"
PRODUCT_URI: Final = "urn:softplc"

_POLICIES: Final = {
    "Basic256Sha256": security_policies.SecurityPolicyBasic256Sha256,
    "Aes128_Sha256_RsaOaep": security_policies.SecurityPolicyAes128Sha256RsaOaep,
    "Aes256_Sha256_RsaPss": security_policies.SecurityPolicyAes256Sha256RsaPss,
}


@dataclass(frozen=True, slots=True)
class Certificates:
    """Our certificate and its key, and the server's certificate where it is given."""

    policy: str
    mode: str
    certificate: x509.Certificate
    private_key: RSAPrivateKey
    server_certificate: x509.Certificate | None
    application_uri: str

    @staticmethod
    def load(security: OpcUaSecurity) -> "Certificates":
        """Read and check the files, unless they are as they were. Raises ConfigError that names the file."""
        ours, server = security.certificate, security.server_certificate
        certificate, key = read_pair(ours, security.private_key)
        return Certificates(
            security.policy,
            security.mode,
            certificate,
            key,
            None if server is None else read_certificate(server),
            _application_uri(ours, certificate),
        )

    async def apply(self, client: Client) -> None:
        """Secure what the library's client will send; asks the server for its certificate where none is given."""
        mode, policy = ua.MessageSecurityMode[self.mode], _POLICIES[self.policy]
        server = self.server_certificate
        if server is None:
            endpoint = client.find_endpoint(await client.connect_and_get_server_endpoints(), mode, policy.URI)
            server = x509_from_der(endpoint.ServerCertificate)
        client.security_policy = policy(server, self.certificate, self.private_key, mode)
        client.uaclient.set_security(client.security_policy)


@dataclass(frozen=True, slots=True)
class Credentials:
    """Who we are to the server."""

    user: str | None
    password: str | None
    certificates: Certificates | None

    @staticmethod
    def load(user: OpcUaUser | None, security: OpcUaSecurity | None) -> "Credentials":
        """Fetch secret and certificates from where the configuration says. Raises ConfigError."""
        return Credentials(
            None if user is None else user.name,
            None if user is None else user.password.read(),
            None if security is None else Certificates.load(security),
        )

    @property
    def application_uri(self) -> str:
        """The one in our certificate, as servers demand it; without certificate one made of the host's name."""
        if self.certificates is not None:
            return self.certificates.application_uri
        return f"urn:{socket.gethostname()}:softplc:client"


def _application_uri(path: str, certificate: x509.Certificate) -> str:
    uris = application_uris(certificate)
    if not uris:
        raise ConfigError(f"{path}: names no application URI; expected a URI in the subject alternative name")
    return uris[0]
