"""The server's own certificate and key: found wrong, warned of, made where there are none."""

import contextlib
import ipaddress
import os
import socket
from collections.abc import Iterator
from datetime import datetime, timedelta
from pathlib import Path
from typing import Final

import structlog
from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric.rsa import RSAPrivateKey, generate_private_key
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from softplc.certificates import application_uris, read_certificate, read_key, read_pair
from softplc.errors import ConfigError
from softplc.publishers.opcua.config import APPLICATION_URI, OpcUaServerSecurity

KEY_BITS: Final = range(2048, 4097)  # what all the offered policies allow (OPC 10000-7)
_MADE_BITS: Final = 2048
_MADE_DAYS: Final = 3650
_WARNED_DAYS: Final = 60
_EVERYWHERE: Final = ("0.0.0.0", "::")

log = structlog.get_logger(__name__)


def problems(security: OpcUaServerSecurity) -> Iterator[tuple[str, str]]:
    """What is wrong with the files, each with the key that names them. What this user may not read is passed over."""
    for key, folder in (("trusted", security.trusted), ("rejected", security.rejected)):
        if folder is not None and os.path.lexists(folder) and not Path(folder).is_dir():
            yield key, f"{folder}: is no folder; expected one, or nothing at all, to have it made"
    if not _are_there(security):
        return
    wrong = []
    for key, path, read in (
        ("certificate", security.certificate, read_certificate),
        ("private_key", security.private_key, read_key),
    ):
        try:
            read(path)
        except ConfigError as error:
            wrong.append(key)
            if not isinstance(error.__cause__, PermissionError):
                yield key, _with_the_other(str(error), error)
    if not wrong:
        try:
            read_pair(security.certificate, security.private_key)
        except ConfigError as error:
            yield "private_key", str(error)
    if "certificate" not in wrong:
        yield from (("certificate", f"{security.certificate}: {text}") for text in _unfit(security.certificate))


def remarks(security: OpcUaServerSecurity, now: datetime) -> Iterator[str]:
    """What works, but not for long or not with every client; nothing where there is no certificate to be read yet."""
    try:
        certificate = read_certificate(security.certificate)
    except ConfigError:
        return
    end = certificate.not_valid_after_utc
    if end <= now:
        yield f"{security.certificate}: is expired since {end:%Y-%m-%d}; clients will refuse it, replace it"
    elif end <= now + timedelta(days=_WARNED_DAYS):
        yield f"{security.certificate}: expires on {end:%Y-%m-%d}; replace it before"
    if certificate.not_valid_before_utc > now:
        begin = certificate.not_valid_before_utc
        yield f"{security.certificate}: is not valid before {begin:%Y-%m-%d}; set this machine's clock, or replace it"


def load_or_make(security: OpcUaServerSecurity, host: str, now: datetime) -> tuple[x509.Certificate, RSAPrivateKey]:
    """Certificate and key; where neither is there, self-signed ones are made and told. Raises ConfigError."""
    if not _are_there(security):
        _make(security, host, now)
    certificate, key = read_pair(security.certificate, security.private_key)
    for text in _unfit(security.certificate):
        raise ConfigError(f"{security.certificate}: {text}")
    for text in remarks(security, now):
        log.warning("opcua server certificate", problem=text)
    return certificate, key


def _are_there(security: OpcUaServerSecurity) -> bool:
    return any(os.path.lexists(path) for path in (security.certificate, security.private_key))


def _with_the_other(text: str, error: ConfigError) -> str:
    if isinstance(error.__cause__, FileNotFoundError):
        return text.partition("; expected")[0] + "; expected both certificate and key, or neither, to have both made"
    return text


def _unfit(path: str) -> Iterator[str]:
    certificate = read_certificate(path)
    uris = application_uris(certificate)
    if APPLICATION_URI not in uris:
        found = ", ".join(uris) or "none"
        yield f"found application URI {found}; expected {APPLICATION_URI} in the subject alternative name"
    bits = getattr(certificate.public_key(), "key_size", 0)
    if bits not in KEY_BITS:
        yield f"found a key of {bits} bits; expected RSA with {KEY_BITS.start} to {KEY_BITS.stop - 1}"


def _make(security: OpcUaServerSecurity, host: str, now: datetime) -> None:
    key = generate_private_key(public_exponent=65537, key_size=_MADE_BITS)
    certificate = _self_signed(key, host, now)
    encoding = Encoding.PEM if security.certificate.endswith(".pem") else Encoding.DER
    secret = key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
    for path, content, mode in (
        (Path(security.private_key), secret, 0o600),
        (Path(security.certificate), certificate.public_bytes(encoding), 0o644),
    ):
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode), "wb") as file:
                file.write(content)
        except OSError as error:
            text = f"{path}: cannot be made: {error.strerror}; expected a folder to write to, or certificate and key"
            raise ConfigError(text) from error
    log.info(
        "opcua server certificate made: self-signed, clients have to trust it",
        certificate=security.certificate,
        private_key=security.private_key,
        thumbprint=certificate.fingerprint(hashes.SHA1()).hex(),  # SHA-1: it is what clients show
        until=f"{certificate.not_valid_after_utc:%Y-%m-%d}",
    )


def _self_signed(key: RSAPrivateKey, host: str, now: datetime) -> x509.Certificate:
    """An application instance certificate (OPC 10000-6, 6.2.2), for `softplc health` that of a client, too."""
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "softplc")])
    usage = x509.KeyUsage(
        digital_signature=True, content_commitment=True, key_encipherment=True, data_encipherment=True,
        key_agreement=False, key_cert_sign=True, crl_sign=False, encipher_only=False, decipher_only=False,
    )  # fmt: skip
    purposes = [ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH]
    identifier = x509.SubjectKeyIdentifier.from_public_key(key.public_key())
    issuer = x509.AuthorityKeyIdentifier.from_issuer_subject_key_identifier(identifier)
    return (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(name)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - timedelta(days=1))  # clocks differ
        .not_valid_after(now + timedelta(days=_MADE_DAYS))
        .add_extension(identifier, critical=False)
        .add_extension(issuer, critical=False)
        .add_extension(x509.SubjectAlternativeName(_names(host)), critical=False)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(usage, critical=True)
        .add_extension(x509.ExtendedKeyUsage(purposes), critical=False)
        .sign(key, hashes.SHA256())
    )


def _names(host: str) -> list[x509.GeneralName]:
    """The application's URI, and what clients may call this machine."""
    names: list[x509.GeneralName] = [x509.UniformResourceIdentifier(APPLICATION_URI)]
    for name in dict.fromkeys([socket.gethostname(), "localhost", "127.0.0.1", host]):
        try:
            if name not in _EVERYWHERE:
                names.append(x509.IPAddress(ipaddress.ip_address(name)))
        except ValueError:
            with contextlib.suppress(UnicodeError):  # no name that a certificate could hold
                names.append(x509.DNSName(name.encode("idna").decode("ascii")))
    return names
