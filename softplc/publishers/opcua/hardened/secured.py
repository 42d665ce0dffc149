"""Secure channels: who may open which, and what is bound to one."""

import hmac
from typing import Any, Final

from asyncua import ua
from asyncua.common.connection import SecureConnection, TransportLimits
from asyncua.common.utils import ServiceError
from asyncua.crypto import uacrypto
from asyncua.crypto.security_policies import SecurityPolicyNone

from softplc.publishers.opcua.hardened.trust import Trust, is_usable, names_itself

POLICIES: Final = (
    ua.SecurityPolicyType.Basic256Sha256_SignAndEncrypt,  # first: the one with which passwords are encrypted on None
    ua.SecurityPolicyType.Basic256Sha256_Sign,
    ua.SecurityPolicyType.Aes128Sha256RsaOaep_SignAndEncrypt,
    ua.SecurityPolicyType.Aes128Sha256RsaOaep_Sign,
    ua.SecurityPolicyType.Aes256Sha256RsaPss_SignAndEncrypt,
    ua.SecurityPolicyType.Aes256Sha256RsaPss_Sign,
)
_NONCE: Final = 32  # bytes that a nonce has at least
_PASSWORD_BLOCKS: Final = 4  # each costs a millisecond of RSA
_DECRYPT: Final = {
    "http://www.w3.org/2001/04/xmlenc#rsa-oaep": uacrypto.decrypt_rsa_oaep,
    "http://opcfoundation.org/UA/security/rsa-oaep-sha2-256": uacrypto.decrypt_rsa_oaep_sha256,
}


class Refused(Exception):
    """No channel is opened, for this reason; the connection ends with it."""

    def __init__(self, code: int) -> None:
        super().__init__(code)
        self.code = code


class Secured(SecureConnection):  # type: ignore[misc]  # asyncua is untyped here
    """One connection's secure channel.

    A client whose certificate is not trusted gets its channel, and the reason when it asks for a session: clients
    show that, and not why a channel was closed.

    asyncua: judges the certificate that CreateSession names, which may be another than the channel's; serves
    everything on SecurityPolicy None though it is not offered.
    """

    def __init__(self, limits: TransportLimits, trust: Trust | None, address: str) -> None:
        super().__init__(SecurityPolicyNone(), limits)
        self._trust, self._address = trust, address
        self._verdict = int(ua.StatusCodes.Good)

    @property
    def is_secured(self) -> bool:
        """Messages are signed."""
        return bool(self.security_policy.URI != SecurityPolicyNone.URI)

    @property
    def bar(self) -> int:
        """Good, or the status of everything but discovery: not trusted, or SecurityPolicy None is not offered."""
        if not self.is_secured and not any(policy.matches(SecurityPolicyNone.URI) for policy in self._policies):
            return int(ua.StatusCodes.BadSecurityPolicyRejected)
        return self._verdict

    @property
    def identity(self) -> tuple[str, Any, bytes]:
        """What a session is bound to: policy, mode and the client's certificate; that on None is nobody's."""
        policy = self.security_policy
        return policy.URI, policy.Mode, policy.peer_certificate if self.is_secured else b""

    def select_policy(self, uri: str, peer_certificate: bytes | None, mode: Any = None) -> None:
        """Take on the policy that a client opens a channel with. Raises Refused."""
        if uri == SecurityPolicyNone.URI:
            peer_certificate = None  # whatever comes along is not looked at
        elif not any(policy.matches(uri) for policy in self._policies):
            raise Refused(ua.StatusCodes.BadSecurityPolicyRejected)
        elif not any(policy.matches(uri, mode) for policy in self._policies):
            raise Refused(ua.StatusCodes.BadSecurityModeRejected)
        elif not is_usable(peer_certificate):
            raise Refused(ua.StatusCodes.BadCertificateInvalid)
        super().select_policy(uri, peer_certificate, mode)

    def open(self, params: Any, server: Any) -> Any:
        """Open the channel, or renew its token: not for whose certificate is no longer good. Raises Refused."""
        if self.is_secured and self._trust is not None:
            if len(params.ClientNonce or b"") < _NONCE:
                raise Refused(ua.StatusCodes.BadNonceInvalid)
            certificate = uacrypto.x509_from_der(self.security_policy.peer_certificate)
            self._verdict = self._trust.judge(certificate, self._address)
            if self.is_open() and self._verdict != ua.StatusCodes.Good:
                raise Refused(self._verdict)
        return super().open(params, server)

    def check_session(self, params: Any) -> None:
        """CreateSession on this channel is by the application that opened it. Raises ServiceError."""
        if not self.is_secured:
            return
        own = self.security_policy.peer_certificate
        if not (params.ClientCertificate or b"").startswith(own):
            raise ServiceError(ua.StatusCodes.BadCertificateInvalid)
        if not names_itself(uacrypto.x509_from_der(own), params.ClientDescription.ApplicationUri):
            raise ServiceError(ua.StatusCodes.BadCertificateUriInvalid)
        if len(params.ClientNonce or b"") < _NONCE:
            raise ServiceError(ua.StatusCodes.BadNonceInvalid)


def open_password(token: Any, key: Any, nonce: bytes, identity: tuple[str, Any, bytes] | None) -> str:
    """The password of a UserNameIdentityToken (OPC 10000-4, 7.40.2.2). Raises ValueError.

    asyncua: one that was encrypted for an earlier session is good for every later one; decrypts with RSA PKCS #1
    v1.5, which tells an attacker about the key; takes one in clear text where messages are signed, not encrypted.
    """
    secret = bytes(token.Password or b"")
    if not token.EncryptionAlgorithm:
        if identity is not None and identity[1] == ua.MessageSecurityMode.Sign:
            raise ValueError("in clear text")
        return secret.decode()
    decrypt = _DECRYPT[token.EncryptionAlgorithm]
    size = key.key_size // 8
    if not 0 < len(secret) <= _PASSWORD_BLOCKS * size:
        raise ValueError("too long")
    plain = b"".join(decrypt(key, secret[start : start + size]) for start in range(0, len(secret), size))
    length = int.from_bytes(plain[:4], "little") - len(nonce)
    if length < 0 or not hmac.compare_digest(plain[4 + length :], nonce):
        raise ValueError("not for this session")
    return plain[4 : 4 + length].decode()
