"""X.509 certificates and RSA keys in files."""

from functools import cache
from pathlib import Path
from stat import S_ISREG
from typing import Final

from cryptography import x509
from cryptography.hazmat.primitives.asymmetric.rsa import RSAPrivateKey
from cryptography.hazmat.primitives.serialization import load_der_private_key, load_pem_private_key

from softplc.errors import ConfigError

_MOST_BYTES: Final = 1 << 20


def read_certificate(path: str) -> x509.Certificate:
    """The certificate in a file, DER or PEM. Raises ConfigError that names the file."""
    return _certificate(path, _age(path))


def read_key(path: str) -> RSAPrivateKey:
    """The private key in a file, PEM or DER. Raises ConfigError that names the file."""
    return _key(path, _age(path))


def read_pair(certificate_path: str, key_path: str) -> tuple[x509.Certificate, RSAPrivateKey]:
    """A certificate and the key that belongs to it. Raises ConfigError that names the file."""
    certificate, key = read_certificate(certificate_path), read_key(key_path)
    if key.public_key() != certificate.public_key():
        raise ConfigError(f"{key_path}: is not the private key of {certificate_path}; expected the pair")
    return certificate, key


def application_uris(certificate: x509.Certificate) -> list[str]:
    """The URIs in the subject alternative name, of which an application's own is the first (OPC 10000-6, 6.2.2)."""
    try:
        names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except x509.ExtensionNotFound:
        return []
    return list(names.get_values_for_type(x509.UniformResourceIdentifier))


def is_pem(content: bytes) -> bool:
    """True for text with BEGIN and END lines, False for what can only be DER."""
    return content.lstrip().startswith(b"-----BEGIN")


def _age(path: str) -> int:
    """When the file was last changed; tells whether what was read of it still holds."""
    try:
        found = Path(path).stat()
    except (OSError, ValueError) as error:  # ValueError: no system has such a path
        raise _unreadable(path, error) from error
    if not S_ISREG(found.st_mode) or found.st_size > _MOST_BYTES:
        raise ConfigError(f"{path}: is no regular file of at most 1 MiB; expected a certificate or key file")
    return found.st_mtime_ns


def _content(path: str) -> bytes:
    try:
        return Path(path).read_bytes()
    except OSError as error:
        raise _unreadable(path, error) from error


def _unreadable(path: str, error: OSError | ValueError) -> ConfigError:
    reason = getattr(error, "strerror", None) or error
    return ConfigError(f"{path}: cannot be read: {reason}; expected a certificate or key file")


@cache
def _certificate(path: str, _age: int) -> x509.Certificate:
    content = _content(path)
    try:
        if is_pem(content):
            return x509.load_pem_x509_certificate(content)
        return x509.load_der_x509_certificate(content)
    except ValueError as error:
        raise ConfigError(f"{path}: is no X.509 certificate; expected one in DER or PEM") from error


@cache
def _key(path: str, _age: int) -> RSAPrivateKey:
    """The key, once for all attempts to connect: checking one takes 35 ms, in which nobody scans."""
    content = _content(path)
    try:
        key = (load_pem_private_key if is_pem(content) else load_der_private_key)(content, None)
    except (ValueError, TypeError) as error:
        raise ConfigError(f"{path}: is no private key without password; expected one in PEM or DER") from error
    if not isinstance(key, RSAPrivateKey):
        raise ConfigError(f"{path}: is no RSA key; expected one, as these security policies use")
    return key
