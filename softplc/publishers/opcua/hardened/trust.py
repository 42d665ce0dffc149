"""Which clients may open a secured channel: a folder of certificates, looked at anew for each."""

import contextlib
import os
import re
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

import structlog
from asyncua import ua
from asyncua.crypto.uacrypto import x509_from_der
from cryptography import x509
from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric.rsa import RSAPublicKey
from cryptography.hazmat.primitives.serialization import Encoding
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from softplc.certificates import application_uris, is_pem
from softplc.clock import Clock
from softplc.errors import ConfigError
from softplc.log_limit import LogLimit
from softplc.publishers.opcua.config import OpcUaServerSecurity
from softplc.publishers.opcua.own_certificate import KEY_BITS
from softplc.publishers.opcua.values import utc

_MOST_REJECTED: Final = 100
_REJECTED_A_MINUTE: Final = 60
_REMEMBERED: Final = 1000  # clients of which the log has been told
_OURS: Final = re.compile(r".* \[[0-9a-f]{40}\]\.der")
_GOOD: Final = int(ua.StatusCodes.Good)

log = structlog.get_logger(__name__)


class Trust:
    """Judges clients' certificates, and keeps those that are refused where they can be trusted from.

    asyncua: judges the certificate that a request names instead of the one that the channel was opened with; also on
    SecurityPolicy None; does not start on an empty folder.
    """

    def __init__(self, security: OpcUaServerSecurity, own: x509.Certificate, clock: Clock) -> None:
        self._trusted = Path(security.trusted)
        self._rejected = None if security.rejected is None else Path(security.rejected)
        self._own, self._clock = own, clock
        self._told: dict[str, int] = {}
        self._lines, self._files = LogLimit(), LogLimit(_REJECTED_A_MINUTE)

    def make_folders(self) -> None:
        """Make the folders that are not there. Raises ConfigError."""
        for folder in (self._trusted, self._rejected):
            try:
                if folder is not None:
                    folder.mkdir(parents=True, exist_ok=True)
            except OSError as error:
                text = f"{folder}: cannot be made: {error.strerror}; expected a folder, or where one can be made"
                raise ConfigError(text) from error

    def judge(self, certificate: x509.Certificate, address: str) -> int:
        """Good, or the status that says why the client with this certificate may not connect (OPC 10000-4, 6.1.3).

        Our own certificate is always good: who has its key is this server, as `softplc health` is.
        """
        status = _GOOD if certificate == self._own else self._status(certificate)
        thumbprint = _thumbprint(certificate)
        if status == _GOOD:
            self._told.pop(thumbprint, None)
        elif self._told.get(thumbprint) != status:
            self._tell(certificate, thumbprint, status, address)
        if status == ua.StatusCodes.BadCertificateUntrusted:
            self._keep(certificate, thumbprint)
        return status

    def _status(self, certificate: x509.Certificate) -> int:
        codes = ua.StatusCodes
        known = list(self._known())
        issuers = [found for found in known if isinstance(found, x509.Certificate) and _issued(found, certificate)]
        if certificate not in known and not issuers:
            return int(codes.BadCertificateUntrusted)
        now = utc(self._clock.utc_ns())
        if not certificate.not_valid_before_utc <= now <= certificate.not_valid_after_utc:
            return int(codes.BadCertificateTimeInvalid)
        if certificate not in known:
            valid = [found for found in issuers if found.not_valid_before_utc <= now <= found.not_valid_after_utc]
            if not valid:
                return int(codes.BadCertificateIssuerTimeInvalid)
            if any(_revoked(found, valid, certificate) for found in known if not isinstance(found, x509.Certificate)):
                return int(codes.BadCertificateRevoked)
        return _GOOD if _is_for_clients(certificate) else int(codes.BadCertificateUseNotAllowed)

    def _known(self) -> Iterator[x509.Certificate | x509.CertificateRevocationList]:
        """What the trusted folder holds now; other files in it are passed over."""
        with contextlib.suppress(OSError), os.scandir(self._trusted) as entries:
            for entry in entries:
                with contextlib.suppress(OSError):
                    if entry.is_file():
                        age = entry.stat()
                        found = _read(entry.path, age.st_mtime_ns, age.st_size)
                        if found is not None:
                            yield found

    def _tell(self, certificate: x509.Certificate, thumbprint: str, status: int, address: str) -> None:
        more = self._lines.ask(self._clock.monotonic())
        if more is None:
            return
        if len(self._told) >= _REMEMBERED:
            self._told.clear()
        self._told[thumbprint] = status
        log.warning(
            "opcua client refused for its certificate",
            status=ua.status_codes.get_name_and_doc(status)[0],
            subject=_common_name(certificate),
            thumbprint=thumbprint,
            address=address,
            **more,
        )

    def _keep(self, certificate: x509.Certificate, thumbprint: str) -> None:
        """Put the certificate into the rejected folder; of more than a hundred, those that came last stay."""
        if self._rejected is None:
            return
        name = re.sub(r"[^A-Za-z0-9._-]", "_", _common_name(certificate))[:64]
        path = self._rejected / f"{name} [{thumbprint}].der"
        if path.exists() or self._files.ask(self._clock.monotonic()) is None:
            return
        try:
            self._rejected.mkdir(parents=True, exist_ok=True)
            path.write_bytes(certificate.public_bytes(Encoding.DER))
            kept = [file for file in self._rejected.iterdir() if _OURS.fullmatch(file.name)]
            for file in sorted(kept, key=lambda file: file.stat().st_mtime_ns)[:-_MOST_REJECTED]:
                file.unlink()
        except OSError as error:
            log.warning("opcua rejected certificate cannot be kept", folder=str(self._rejected), error=error.strerror)


@lru_cache(maxsize=2048)
def _read(path: str, _changed: int, _size: int) -> x509.Certificate | x509.CertificateRevocationList | None:
    """The certificate or revocation list in a file; None, told once, for what looks like one and is none."""
    content = Path(path).read_bytes()
    readers: Any = (
        (x509.load_pem_x509_certificate, x509.load_pem_x509_crl)
        if is_pem(content)
        else (x509.load_der_x509_certificate, x509.load_der_x509_crl)
    )
    for reader in readers:
        with contextlib.suppress(ValueError):
            return reader(content)  # type: ignore[no-any-return]
    log.warning("opcua trusted folder: no certificate and no revocation list", file=path)
    return None


def _issued(issuer: x509.Certificate, certificate: x509.Certificate) -> bool:
    """The issuer is an authority, and signed the certificate."""
    try:
        if not issuer.extensions.get_extension_for_class(x509.BasicConstraints).value.ca:
            return False
        certificate.verify_directly_issued_by(issuer)
    except (x509.ExtensionNotFound, InvalidSignature, ValueError, TypeError, UnsupportedAlgorithm):
        return False
    return True


def _revoked(crl: Any, issuers: list[x509.Certificate], certificate: x509.Certificate) -> bool:
    if crl.get_revoked_certificate_by_serial_number(certificate.serial_number) is None:
        return False
    return any(crl.issuer == issuer.subject and crl.is_signature_valid(issuer.public_key()) for issuer in issuers)


def _is_for_clients(certificate: x509.Certificate) -> bool:
    """Where the certificate says what it is for, that is to sign, and to be a client."""
    extensions = certificate.extensions
    with contextlib.suppress(x509.ExtensionNotFound):
        if not extensions.get_extension_for_class(x509.KeyUsage).value.digital_signature:
            return False
    with contextlib.suppress(x509.ExtensionNotFound):
        return ExtendedKeyUsageOID.CLIENT_AUTH in extensions.get_extension_for_class(x509.ExtendedKeyUsage).value
    return True


def is_usable(data: bytes | None) -> bool:
    """A certificate that can be read, RSA of a length that all the offered policies allow, not signed with SHA-1."""
    try:
        certificate = x509_from_der(data)
        key, signed = certificate.public_key(), certificate.signature_hash_algorithm
        _ = certificate.extensions, certificate.not_valid_before_utc, certificate.not_valid_after_utc
    except Exception:  # cryptography raises what comes where a certificate is broken
        return False
    weak = signed is None or isinstance(signed, hashes.SHA1 | hashes.MD5)
    return isinstance(key, RSAPublicKey) and key.key_size in KEY_BITS and not weak


def names_itself(certificate: x509.Certificate, uri: str | None) -> bool:
    """The certificate is that of the application with this URI."""
    return uri in application_uris(certificate)


def _thumbprint(certificate: x509.Certificate) -> str:
    return certificate.fingerprint(hashes.SHA1()).hex()  # SHA-1: it is what clients show


def _common_name(certificate: x509.Certificate) -> str:
    try:
        names = certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    except ValueError:
        return "unreadable"
    return str(names[0].value) if names else "unnamed"
