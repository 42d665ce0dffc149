"""A client's own certificate and key, made on the spot."""

from datetime import UTC, datetime, timedelta
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec, rsa
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

URI = "urn:softplc:test:client"
Key = rsa.RSAPrivateKey | ec.EllipticCurvePrivateKey


def make_certificate(folder: Path, uri: str | None = URI, encoding: Encoding = Encoding.DER) -> tuple[Path, Path]:
    """Certificate and key as files in the folder."""
    key = rsa.generate_private_key(public_exponent=65537, key_size=2048)
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "softplc test")])
    now = datetime.now(UTC)
    builder = (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(name)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - timedelta(days=1))
        .not_valid_after(now + timedelta(days=2))
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(
            x509.KeyUsage(True, True, True, True, False, False, False, False, False),
            critical=True,
        )
        .add_extension(x509.ExtendedKeyUsage([ExtendedKeyUsageOID.CLIENT_AUTH]), critical=False)
    )
    names: list[x509.GeneralName] = [x509.DNSName("localhost")]
    if uri is not None:
        names.append(x509.UniformResourceIdentifier(uri))
    builder = builder.add_extension(x509.SubjectAlternativeName(names), critical=False)
    certificate, private_key = folder / "client.crt", folder / "client.key"
    certificate.write_bytes(builder.sign(key, hashes.SHA256()).public_bytes(encoding))
    write_key(private_key, key)
    return certificate, private_key


def write_key(path: Path, key: Key) -> None:
    """A key in PEM."""
    path.write_bytes(key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
