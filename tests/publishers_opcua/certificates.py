"""Clients with certificates of every kind, and a secured server that trusts some of them."""

import contextlib
from collections.abc import AsyncIterator
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from functools import cache, cached_property
from pathlib import Path
from typing import Any

from asyncua import Client, ua
from asyncua.crypto import security_policies
from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import rsa
from cryptography.hazmat.primitives.serialization import Encoding
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from softplc.publishers.opcua.config import OpcUaServerSecurity
from softplc.publishers.opcua.hardened.limits import Limits
from tests.publishers_opcua.conftest import PASSWORD, Served, serve

URI = "urn:softplc:test:hmi"
POLICIES = {
    "Basic256Sha256": security_policies.SecurityPolicyBasic256Sha256,
    "Aes128_Sha256_RsaOaep": security_policies.SecurityPolicyAes128Sha256RsaOaep,
    "Aes256_Sha256_RsaPss": security_policies.SecurityPolicyAes256Sha256RsaPss,
}


@cache
def key(name: str, bits: int = 2048) -> rsa.RSAPrivateKey:
    """A key for everyone of this name; making one takes long."""
    return rsa.generate_private_key(public_exponent=65537, key_size=bits)


@dataclass(eq=False)
class Application:
    """An application instance certificate and its key; days are counted from now."""

    name: str = "hmi"
    uri: str = URI
    begin: float = -10.0
    end: float = 10.0
    bits: int = 2048
    pair: str = "client"  # those of one name have the same key
    purpose: x509.ObjectIdentifier = ExtendedKeyUsageOID.CLIENT_AUTH
    authority: bool = False
    issuer: "Application | None" = None

    @property
    def key(self) -> rsa.RSAPrivateKey:
        return key(self.pair, self.bits)

    @property
    def subject(self) -> x509.Name:
        return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, self.name)])

    @cached_property
    def certificate(self) -> x509.Certificate:
        issuer, now = self.issuer or self, datetime.now(UTC)
        names = [x509.UniformResourceIdentifier(self.uri)]
        return (
            x509.CertificateBuilder()
            .subject_name(self.subject)
            .issuer_name(issuer.subject)
            .public_key(self.key.public_key())
            .serial_number(x509.random_serial_number())
            .not_valid_before(now + timedelta(days=self.begin))
            .not_valid_after(now + timedelta(days=self.end))
            .add_extension(x509.BasicConstraints(ca=self.authority, path_length=None), critical=True)
            .add_extension(x509.ExtendedKeyUsage([self.purpose]), critical=False)
            .add_extension(x509.SubjectAlternativeName(names), critical=False)
            .sign(issuer.key, hashes.SHA256())
        )

    @property
    def der(self) -> bytes:
        return self.certificate.public_bytes(Encoding.DER)

    def revokes(self, *others: "Application") -> bytes:
        """A revocation list of this authority."""
        now = datetime.now(UTC)
        builder = x509.CertificateRevocationListBuilder().issuer_name(self.subject)
        builder = builder.last_update(now - timedelta(days=1)).next_update(now + timedelta(days=9))
        for other in others:
            revoked = x509.RevokedCertificateBuilder().serial_number(other.certificate.serial_number)
            builder = builder.add_revoked_certificate(revoked.revocation_date(now - timedelta(hours=1)).build())
        return builder.sign(self.key, hashes.SHA256()).public_bytes(Encoding.DER)


HMI = Application()


@dataclass
class Secured:
    """A server with a certificate, and the folders that it looks into."""

    served: Served
    folder: Path

    @property
    def trusted(self) -> Path:
        return self.folder / "trusted"

    @property
    def rejected(self) -> Path:
        return self.folder / "rejected"

    def trust(self, *applications: Application) -> None:
        for application in applications:
            (self.trusted / f"{application.name}.der").write_bytes(application.der)

    def client(
        self,
        application: Application = HMI,
        policy: str = "Basic256Sha256",
        mode: str = "SignAndEncrypt",
        user: str | None = None,
    ) -> Client:
        """An asyncua client of this application, not yet connected."""
        client = self.served.client(user, PASSWORD)
        own = x509.load_der_x509_certificate((self.folder / "own/softplc.der").read_bytes())
        client.application_uri = application.uri
        client.security_policy = POLICIES[policy](
            own, application.certificate, application.key, ua.MessageSecurityMode[mode]
        )
        client.uaclient.set_security(client.security_policy)
        return client

    async def refuses(self, application: Application = HMI, **options: Any) -> str:
        """Name of the status with which this client is refused; Good when it is not."""
        client = self.client(application, **options)
        try:
            async with client:
                await client.get_namespace_array()
        except ua.UaStatusCodeError as error:
            return type(error).__name__
        return "Good"


def security(folder: Path, **options: Any) -> OpcUaServerSecurity:
    """Certificate, key and folders, all below this one."""
    return OpcUaServerSecurity(
        certificate=str(folder / "own/softplc.der"),
        private_key=str(folder / "own/softplc.pem"),
        trusted=str(folder / "trusted"),
        rejected=str(folder / "rejected"),
        **options,
    )


@contextlib.asynccontextmanager
async def serve_secured(folder: Path, limits: Limits | None = None, **options: Any) -> AsyncIterator[Secured]:
    """A secured server that trusts nobody yet."""
    async with serve(limits, security=security(folder, **options)) as served:
        yield Secured(served, folder)
