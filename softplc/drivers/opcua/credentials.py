"""What a client shows of itself to a server: application name and URI, user, certificate. Read once, at start."""

import socket
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Final

from asyncua import Client, ua
from asyncua.crypto import security_policies
from asyncua.crypto.uacrypto import x509_from_der
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric.rsa import RSAPrivateKey
from cryptography.hazmat.primitives.serialization import load_der_private_key, load_pem_private_key

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
        certificate, key = _pair(ours, security.private_key, _age(ours), _age(security.private_key))
        return Certificates(
            security.policy,
            security.mode,
            certificate,
            key,
            None if server is None else _certificate(server, _age(server)),
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


def _age(path: str) -> int:
    """When the file was last changed; tells whether what was read of it still holds."""
    try:
        return Path(path).stat().st_mtime_ns
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}; expected a certificate or key file") from error


def _content(path: str) -> bytes:
    try:
        return Path(path).read_bytes()
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}; expected a certificate or key file") from error


def _is_pem(content: bytes) -> bool:
    return content.lstrip().startswith(b"-----BEGIN")


@cache
def _certificate(path: str, age: int) -> x509.Certificate:
    content = _content(path)
    try:
        return (
            x509.load_pem_x509_certificate(content) if _is_pem(content) else x509.load_der_x509_certificate(content)
        )
    except ValueError as error:
        raise ConfigError(f"{path}: is no X.509 certificate; expected one in DER or PEM") from error


@cache
def _pair(
    certificate_path: str, key_path: str, certificate_age: int, key_age: int
) -> tuple[x509.Certificate, RSAPrivateKey]:
    """Certificate and key, once for all attempts to connect: checking a key takes 35 ms, in which nobody scans."""
    certificate = _certificate(certificate_path, certificate_age)
    content = _content(key_path)
    try:
        key = (load_pem_private_key if _is_pem(content) else load_der_private_key)(content, None)
    except (ValueError, TypeError) as error:
        raise ConfigError(f"{key_path}: is no private key without password; expected one in PEM or DER") from error
    if not isinstance(key, RSAPrivateKey):
        raise ConfigError(f"{key_path}: is no RSA key; expected one, as these security policies use")
    if key.public_key() != certificate.public_key():
        raise ConfigError(f"{key_path}: is not the private key of {certificate_path}; expected the pair")
    return certificate, key


def _application_uri(path: str, certificate: x509.Certificate) -> str:
    try:
        names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
        uris = names.get_values_for_type(x509.UniformResourceIdentifier)
    except x509.ExtensionNotFound:
        uris = []
    if not uris:
        raise ConfigError(f"{path}: names no application URI; expected a URI in the subject alternative name")
    return uris[0]
