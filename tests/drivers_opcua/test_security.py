"""Who we are to the server: user, password, certificates, and what is wrong with them."""

from pathlib import Path

import pytest
from cryptography.hazmat.primitives.asymmetric import ec, rsa
from cryptography.hazmat.primitives.serialization import Encoding

from softplc.drivers.opcua.config import OpcUaSecurity, OpcUaUser
from softplc.drivers.opcua.left import LEFT_SESSIONS
from softplc.errors import ConfigError, LinkError
from softplc.model import Secret
from tests.drivers_opcua.certificates import URI, make_certificate, write_key
from tests.drivers_opcua.opened import make_driver, opened, read
from tests.drivers_opcua.servers import AsyncuaPlc, NodePlc

TAGS = ["ns=2;s=PLC.Axis.Float"]
PASSWORD = "SOFTPLC_TEST_OPCUA_PASSWORD"  # the variable's name


def operator(monkeypatch: pytest.MonkeyPatch, password: str) -> OpcUaUser:
    monkeypatch.setenv(PASSWORD, password)
    return OpcUaUser(name="operator", password=Secret(env=PASSWORD))


@pytest.mark.parametrize("policy", ["Basic256Sha256", "Aes128_Sha256_RsaOaep", "Aes256_Sha256_RsaPss"])
@pytest.mark.parametrize(("mode", "encoding"), [("SignAndEncrypt", Encoding.DER), ("Sign", Encoding.PEM)])
async def test_a_secured_channel_carries_values(
    plc: NodePlc, tmp_path: Path, policy: str, mode: str, encoding: Encoding
):
    certificate, key = make_certificate(tmp_path, encoding=encoding)
    security = OpcUaSecurity.model_validate(
        {"policy": policy, "mode": mode, "certificate": str(certificate), "private_key": str(key)}
    )
    async with opened(plc.url, TAGS, security=security) as driver:
        assert (await read(driver, 1)).values[0] == 0.5
        assert driver._session._client.application_uri == URI


@pytest.mark.parametrize("secured", [False, True])
async def test_a_user_logs_in_with_a_password_from_the_environment(
    plc: NodePlc, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, secured: bool
):
    security = None
    if secured:
        certificate, key = make_certificate(tmp_path)
        security = OpcUaSecurity(certificate=str(certificate), private_key=str(key))
    async with opened(plc.url, TAGS, security=security, user=operator(monkeypatch, "secret")) as driver:
        assert (await read(driver, 1)).values[0] == 0.5
        assert driver.remarks == ()  # this server has passwords encrypted on every channel


async def test_a_password_in_clear_text_is_remarked_on(asyncua_plc: AsyncuaPlc, monkeypatch: pytest.MonkeyPatch):
    async with opened(asyncua_plc.url, [], user=operator(monkeypatch, "secret")) as driver:
        assert "clear text" in driver.remarks[0]


async def test_a_wrong_password_is_a_link_error_that_does_not_show_it(plc: NodePlc, monkeypatch: pytest.MonkeyPatch):
    driver = make_driver(plc.url, TAGS, user=operator(monkeypatch, "guessed"))
    with pytest.raises(LinkError, match="cannot connect") as error:
        await driver.open()

    assert "guessed" not in str(error.value)


async def test_a_server_without_the_wanted_security_is_told(asyncua_plc: AsyncuaPlc, tmp_path: Path):
    certificate, key = make_certificate(tmp_path)
    security = OpcUaSecurity(certificate=str(certificate), private_key=str(key))
    with pytest.raises(LinkError, match="no endpoint with Basic256Sha256 and SignAndEncrypt"):
        await make_driver(asyncua_plc.url, TAGS, security=security).open()


def test_a_missing_secret_or_certificate_is_a_configuration_error(tmp_path: Path):
    user = OpcUaUser(name="operator", password=Secret(env="SOFTPLC_TEST_NOT_SET"))
    with pytest.raises(ConfigError, match="SOFTPLC_TEST_NOT_SET is not set"):
        make_driver("opc.tcp://127.0.0.1:4840", TAGS, user=user)

    certificate, key = make_certificate(tmp_path)
    text, other, curve = tmp_path / "text", tmp_path / "other.key", tmp_path / "curve.key"
    text.write_text("nothing")
    write_key(other, rsa.generate_private_key(public_exponent=65537, key_size=2048))
    write_key(curve, ec.generate_private_key(ec.SECP256R1()))
    for wrong_certificate, wrong_key, found in (
        (tmp_path / "absent", key, "absent: cannot be read"),
        (text, key, "is no X.509 certificate"),
        (certificate, text, "is no private key"),
        (certificate, other, "is not the private key of"),
        (certificate, curve, "is no RSA key"),
    ):
        security = OpcUaSecurity(certificate=str(wrong_certificate), private_key=str(wrong_key))
        with pytest.raises(ConfigError, match=found):
            make_driver("opc.tcp://127.0.0.1:4840", TAGS, security=security)

    certificate, key = make_certificate(tmp_path, uri=None)
    security = OpcUaSecurity(certificate=str(certificate), private_key=str(key))
    with pytest.raises(ConfigError, match="names no application URI"):
        make_driver("opc.tcp://127.0.0.1:4840", TAGS, security=security)


@pytest.mark.parametrize("mode", ["poll", "subscribe"])
@pytest.mark.parametrize("secured", [False, True])
async def test_sessions_of_broken_connections_are_closed_over_the_next_one(
    plc: NodePlc, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, secured: bool, mode: str
):
    security = None
    if secured:
        certificate, key = make_certificate(tmp_path)
        security = OpcUaSecurity(certificate=str(certificate), private_key=str(key))
    config = {"security": security, "user": operator(monkeypatch, "secret"), "mode": mode}
    before = plc.do("count").split()
    for _ in range(12):  # the server has room for ten sessions and keeps one without a connection for 30 s
        async with opened(plc.url, TAGS, **config) as driver:
            assert (await read(driver, 1)).values[0] == 0.5
            driver._session._transport.protocol.transport.abort()
    async with opened(plc.url, TAGS, **config) as driver:
        sessions, subscriptions = (
            int(now) - int(then) for now, then in zip(plc.do("count").split(), before, strict=True)
        )
        assert (sessions, subscriptions) <= (1, 1)
        assert LEFT_SESSIONS.count(driver._session._key) == 0
