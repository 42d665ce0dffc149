"""The server's own certificate: made, judged, used."""

import asyncio
import stat
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat

from softplc.app.checking import certificate_remarks
from softplc.app.health import check_health
from softplc.config.load import load
from softplc.errors import ConfigError
from tests.publishers_opcua.certificates import HMI, URI, Application, Secured, security, serve_secured
from tests.publishers_opcua.conftest import serve

pytestmark = pytest.mark.asyncio(loop_scope="module")


async def test_certificate_and_key_are_made_at_the_first_start_and_kept(tmp_path: Path) -> None:
    own, secret = tmp_path / "own/softplc.der", tmp_path / "own/softplc.pem"
    async with serve_secured(tmp_path):
        made = own.read_bytes()
    async with serve_secured(tmp_path):
        assert own.read_bytes() == made

    assert stat.S_IMODE(secret.stat().st_mode) == 0o600
    certificate = x509.load_der_x509_certificate(made)
    names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    assert names.get_values_for_type(x509.UniformResourceIdentifier) == ["urn:softplc:server"]
    assert "127.0.0.1" in [str(address) for address in names.get_values_for_type(x509.IPAddress)]


async def test_health_asks_a_secured_server_as_the_server_itself(tmp_path: Path) -> None:
    (tmp_path / "pki").mkdir()
    async with serve_secured(tmp_path / "pki") as server:
        config = load(_written(tmp_path, server.served.port))
        asked = asyncio.create_task(asyncio.to_thread(check_health, config, 20.0))
        while not asked.done():
            server.served.exchange.set("Tasks.main.Heartbeat", server.served.exchange.scans % 65536)
            await server.served.scan()
            await asyncio.sleep(0.02)

        assert await asked == ""
        assert list(server.rejected.iterdir()) == []


def _written(folder: Path, port: int = 4840, **keys: str) -> Path:
    """A configuration with a secured server; its paths begin at the folder of the file."""
    lines = {
        "certificate": "pki/own/softplc.der",
        "private_key": "pki/own/softplc.pem",
        "trusted": "pki/trusted",
    } | keys
    path = folder / "softplc.yaml"
    path.write_text(
        'sources:\n  - {name: plc1, type: opcua, url: "opc.tcp://127.0.0.1:4841"}\n'
        "axes:\n  - name: AxisX\n    input: {source: plc1, node: ns=2;s=AxisX.Position}\n"
        "    observer: {type: aoi, r_x: 1}\n"
        f"publishers:\n  - type: opcua\n    port: {port}\n    security:\n"
        + "".join(f"      {name}: {value}\n" for name, value in lines.items())
    )
    return path


async def test_an_expired_own_certificate_serves_and_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    own = Application("softplc", uri="urn:softplc:server", end=-1.0)
    _put(tmp_path, own)
    async with serve(security=security(tmp_path)) as served:
        server = Secured(served, tmp_path)
        server.trust(HMI)

        assert await server.refuses() == "Good"
    assert "is expired since" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("begin", "end", "told"),
    [(-9, -1, "is expired since"), (-9, 50, "expires on"), (1, 900, "is not valid before"), (-9, 900, "")],
)
async def test_check_says_when_the_certificate_is_of_no_use(
    tmp_path: Path, begin: float, end: float, told: str
) -> None:
    _put(tmp_path / "pki", Application("softplc", uri="urn:softplc:server", begin=begin, end=end))

    texts = certificate_remarks(load(_written(tmp_path)))

    assert [told in text for text in texts] == [True] * bool(told)


def _put(folder: Path, own: Application, pair: Application | None = None) -> None:
    (folder / "own").mkdir(parents=True)
    (folder / "own/softplc.der").write_bytes(own.der)
    key = (pair or own).key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
    (folder / "own/softplc.pem").write_bytes(key)


OWN = Application("softplc", uri="urn:softplc:server")
OTHER = Application(pair="other")
WRONG: tuple[tuple[Application, Application, dict[str, str], int, str], ...] = (
    (OWN, OTHER, {}, 12, "private_key: .*softplc.pem: is not the private key of .*softplc.der; expected the pair"),
    (HMI, HMI, {}, 11, f"certificate: .*application URI {URI}; expected urn:softplc:server in the subject"),
    (Application(uri=OWN.uri, bits=1024), Application(bits=1024), {}, 11, "certificate: .*a key of 1024 bits"),
    (OWN, OWN, {"private_key": "softplc.yaml"}, 12, "softplc.yaml: is no private key without password"),
    (OWN, OWN, {"certificate": "softplc.yaml"}, 11, "softplc.yaml: is no X.509 certificate"),
    (OWN, OWN, {"certificate": "/dev/zero"}, 11, "/dev/zero: is no regular file of at most 1 MiB"),
    (OWN, OWN, {"private_key": "absent"}, 12, "absent: cannot be read: .*expected both certificate and key, or"),
    (OWN, OWN, {"trusted": "softplc.yaml"}, 13, "trusted: .*softplc.yaml: is no folder; expected one, or nothing"),
    (OWN, OWN, {"rejected": "pki/trusted"}, 11, "rejected is the folder of trusted"),
)


@pytest.mark.parametrize("number", range(len(WRONG)))
async def test_what_is_wrong_with_the_files_is_told_with_its_line(tmp_path: Path, number: int) -> None:
    own, pair, keys, line, found = WRONG[number]
    _put(tmp_path / "pki", own, pair)

    with pytest.raises(ConfigError, match=rf"softplc.yaml:{line}:.*publishers\[0\].security.*{found}"):
        load(_written(tmp_path, **keys))


async def test_files_that_are_still_to_be_made_are_no_error(tmp_path: Path) -> None:
    publisher = load(_written(tmp_path)).publishers[0]

    assert publisher.security.certificate == str(tmp_path / "pki/own/softplc.der")  # type: ignore[union-attr]


async def test_a_folder_that_nobody_may_write_to_is_an_error_at_the_start(tmp_path: Path) -> None:
    (tmp_path / "own").write_text("no folder")

    with pytest.raises(ConfigError, match=r"softplc.pem: cannot be made: .*expected a folder to write to"):
        async with serve_secured(tmp_path):
            pass
