"""What a client shows of itself to a server: application name and URI, user, certificate. Read once, at start."""

import socket
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from asyncua import Client, ua
from asyncua.crypto import security_policies
from asyncua.crypto.uacrypto import CertProperties
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric.rsa import RSAPrivateKey
from cryptography.hazmat.primitives.serialization import Encoding, load_der_private_key, load_pem_private_key

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
    """Our certificate (DER), its private key (PEM or DER) and, where given, the server's certificate (DER)."""

    policy: str
    mode: str
    certificate: bytes
    private_key: bytes
    server_certificate: bytes | None
    application_uri: str

    @staticmethod
    def load(security: OpcUaSecurity) -> "Certificates":
        """Read and check the files. Raises ConfigError with the file, what was found and what would be right."""
        certificate = _certificate(security.certificate)
        key = _content(security.private_key)
        if _private_key(security.private_key, key).public_key() != certificate.public_key():
            raise ConfigError(
                f"{security.private_key}: is not the private key of {security.certificate}; expected the pair"
            )
        server = None
        if security.server_certificate is not None:
            server = _certificate(security.server_certificate).public_bytes(Encoding.DER)
        return Certificates(
            security.policy,
            security.mode,
            certificate.public_bytes(Encoding.DER),
            key,
            server,
            _application_uri(security.certificate, certificate),
        )

    async def apply(self, client: Client) -> None:
        """Prepare the library's client; asks the server for its certificate where none is given."""
        await client.set_security(
            _POLICIES[self.policy],
            CertProperties(self.certificate, "der"),
            CertProperties(self.private_key, "pem" if _is_pem(self.private_key) else "der"),
            server_certificate=None
            if self.server_certificate is None
            else CertProperties(self.server_certificate, "der"),
            mode=ua.MessageSecurityMode[self.mode],
        )


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


def _content(path: str) -> bytes:
    try:
        return Path(path).read_bytes()
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}; expected a certificate or key file") from error


def _is_pem(content: bytes) -> bool:
    return content.lstrip().startswith(b"-----BEGIN")


def _certificate(path: str) -> x509.Certificate:
    content = _content(path)
    try:
        return (
            x509.load_pem_x509_certificate(content) if _is_pem(content) else x509.load_der_x509_certificate(content)
        )
    except ValueError as error:
        raise ConfigError(f"{path}: is no X.509 certificate; expected one in DER or PEM") from error


def _private_key(path: str, content: bytes) -> RSAPrivateKey:
    try:
        key = (load_pem_private_key if _is_pem(content) else load_der_private_key)(content, None)
    except (ValueError, TypeError) as error:
        raise ConfigError(f"{path}: is no private key without password; expected one in PEM or DER") from error
    if not isinstance(key, RSAPrivateKey):
        raise ConfigError(f"{path}: is a {type(key).__name__}; expected an RSA key, as these security policies use")
    return key


def _application_uri(path: str, certificate: x509.Certificate) -> str:
    try:
        names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
        uris = names.get_values_for_type(x509.UniformResourceIdentifier)
    except x509.ExtensionNotFound:
        uris = []
    if not uris:
        raise ConfigError(f"{path}: names no application URI; expected a URI in the subject alternative name")
    return uris[0]
