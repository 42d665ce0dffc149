"""Which clients' certificates are good for a secured channel."""

import asyncio
import os
import shutil
import time
from collections.abc import AsyncIterator
from pathlib import Path

import pytest
import pytest_asyncio
from asyncua import ua
from cryptography.x509.oid import ExtendedKeyUsageOID

from softplc.clock import VirtualClock
from softplc.publishers.opcua.hardened.trust import Trust
from tests.publishers_opcua.certificates import HMI, Application, Secured, security, serve_secured
from tests.publishers_opcua.conftest import node_client, refused

pytestmark = pytest.mark.asyncio(loop_scope="module")


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def module_server(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[Secured]:
    async with serve_secured(tmp_path_factory.mktemp("secured")) as server:
        yield server


@pytest.fixture
def server(module_server: Secured) -> Secured:
    """A server that trusts nobody and has refused nobody."""
    for folder in (module_server.trusted, module_server.rejected):
        for file in folder.iterdir():
            file.unlink()
    return module_server


async def test_an_unknown_client_is_refused_and_moving_its_certificate_lets_it_in(server: Secured) -> None:
    assert await server.refuses() == "BadCertificateUntrusted"

    [file] = server.rejected.iterdir()
    assert file.read_bytes() == HMI.der
    assert file.name.startswith("hmi [")
    shutil.move(file, server.trusted)
    assert await server.refuses() == "Good"


async def test_node_opcua_is_told_why_it_is_refused_and_let_in_without_a_restart(
    server: Secured, tmp_path: Path
) -> None:
    server.served.clock.advance(60.0)  # it makes its certificate after the server's start
    how = {"connect": server.served.url, "policy": "Aes256_Sha256_RsaPss", "mode": "SignAndEncrypt"}
    async with node_client(tmp_path) as stranger:
        assert "BadCertificateUntrusted" in (await stranger.ask(**how))["error"]

        [file] = server.rejected.iterdir()
        shutil.move(file, server.trusted)
        assert "namespaces" in await stranger.ask(**how)


async def test_whoever_is_no_longer_trusted_does_not_come_back(server: Secured) -> None:
    server.trust(HMI)
    assert await server.refuses() == "Good"
    (server.trusted / "hmi.der").unlink()

    assert await server.refuses() == "BadCertificateUntrusted"


async def test_a_channel_is_not_renewed_for_whom_nobody_trusts_any_more(server: Secured) -> None:
    server.trust(HMI)
    client = server.client()
    await client.connect()
    (server.trusted / "hmi.der").unlink()
    gone = asyncio.get_running_loop().create_future()
    client.uaclient.protocol.connection_lost = lambda _: gone.set_result(None)

    renewal = asyncio.ensure_future(client.open_secure_channel(renew=True))
    async with asyncio.timeout(20):
        await gone

    renewal.cancel()
    await asyncio.gather(renewal, return_exceptions=True)
    client.disconnect_socket()


async def test_a_folder_that_vanishes_trusts_nobody(tmp_path: Path) -> None:
    async with serve_secured(tmp_path) as server:
        server.trust(HMI)
        shutil.rmtree(server.trusted)

        assert await server.refuses() == "BadCertificateUntrusted"


async def test_other_files_in_the_folder_are_passed_over(server: Secured) -> None:
    (server.trusted / "README").write_text("certificates of HMIs")
    (server.trusted / "broken.der").write_bytes(HMI.der[:-9])
    (server.trusted / "folder").mkdir()
    os.mkfifo(server.trusted / "pipe")
    server.trust(HMI)

    assert await server.refuses() == "Good"
    (server.trusted / "folder").rmdir()


CASES = {
    "expired": (Application(end=-1.0), "BadCertificateTimeInvalid"),
    "not valid yet": (Application(begin=1.0), "BadCertificateTimeInvalid"),
    "a server's": (Application(purpose=ExtendedKeyUsageOID.SERVER_AUTH), "BadCertificateUseNotAllowed"),
}


@pytest.mark.parametrize("what", CASES)
async def test_a_trusted_certificate_is_judged_nevertheless(server: Secured, what: str) -> None:
    application, status = CASES[what]
    server.trust(application)

    assert await server.refuses(application) == status
    assert list(server.rejected.iterdir()) == []


async def test_whom_a_trusted_authority_vouches_for_is_let_in_until_it_revokes_that(server: Secured) -> None:
    authority = Application("plant CA", authority=True)
    issued = Application("issued", issuer=authority)
    other = Application("other", issuer=authority)
    server.trust(authority)
    assert [await server.refuses(who) for who in (issued, other)] == ["Good", "Good"]

    (server.trusted / "plant.crl").write_bytes(authority.revokes(issued))

    assert [await server.refuses(who) for who in (issued, other)] == ["BadCertificateRevoked", "Good"]


@pytest.mark.parametrize(
    ("authority", "status"),
    [
        (Application("plant CA", authority=True, end=-1.0), "BadCertificateIssuerTimeInvalid"),
        (Application("plant CA", authority=False), "BadCertificateUntrusted"),
    ],
)
async def test_an_authority_must_be_one_and_valid(server: Secured, authority: Application, status: str) -> None:
    server.trust(authority)

    assert await server.refuses(Application("issued", issuer=authority)) == status


async def test_a_revocation_list_that_the_authority_did_not_sign_revokes_nothing(server: Secured) -> None:
    authority = Application("plant CA", authority=True)
    issued = Application("issued", issuer=authority)
    server.trust(authority)
    impostor = Application("plant CA", authority=True, pair="impostor")
    (server.trusted / "forged.crl").write_bytes(impostor.revokes(issued))

    assert await server.refuses(issued) == "Good"


async def test_the_application_must_be_the_one_of_its_certificate(server: Secured) -> None:
    server.trust(HMI)
    client = server.client()
    client.application_uri = "urn:somebody:else"

    with pytest.raises(ua.UaStatusCodeError) as error:
        await client.connect()

    assert refused(error) == ua.StatusCodes.BadCertificateUriInvalid


@pytest.mark.parametrize(
    ("opened_by", "named", "status"),
    [("stranger", "hmi", "BadCertificateUntrusted"), ("hmi", "stranger", "BadCertificateInvalid")],
)
async def test_the_certificate_of_the_channel_counts_and_a_request_names_no_other(
    server: Secured, opened_by: str, named: str, status: str
) -> None:
    server.trust(HMI)
    who = {"hmi": HMI, "stranger": Application("stranger", pair="other")}
    client = server.client(who[opened_by])
    await client.connect_socket()
    await client.send_hello()
    await client.open_secure_channel()
    client.security_policy.host_certificate = who[named].der
    with pytest.raises(ua.UaStatusCodeError) as error:
        await client.create_session()

    assert type(error.value).__name__ == status
    client.disconnect_socket()


async def test_a_weak_key_opens_no_channel(server: Secured) -> None:
    weak = Application("weak", bits=1024)
    server.trust(weak)

    with pytest.raises((ua.UaError, ConnectionError, TimeoutError)):
        await server.client(weak).connect()

    assert server.served.server._server.iserver._external_sessions == {}


async def test_a_flood_of_strangers_writes_at_most_sixty_files_a_minute(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    clock = VirtualClock(utc_ns=time.time_ns())
    trust = Trust(security(tmp_path), Application("server").certificate, clock)
    strangers = [Application(f"hmi{number:03}").certificate for number in range(70)]

    for stranger in strangers * 2:
        trust.judge(stranger, "127.0.0.1")

    assert len(list((tmp_path / "rejected").iterdir())) == 60
    assert 1 <= capsys.readouterr().out.count("BadCertificateUntrusted") <= 10


async def test_at_most_a_hundred_rejected_certificates_are_kept_the_newest(tmp_path: Path) -> None:
    clock = VirtualClock(utc_ns=time.time_ns())
    (tmp_path / "rejected").mkdir()
    (tmp_path / "rejected/notes.txt").write_text("ours")
    trust = Trust(security(tmp_path), Application("server").certificate, clock)
    for number in range(105):
        clock.advance(2.0)
        name = f"hmi{number:03}"
        trust.judge(Application(name).certificate, "127.0.0.1")
        os.utime(next((tmp_path / "rejected").glob(f"{name} *")), ns=(number, number + 1))

    names = sorted(file.name for file in (tmp_path / "rejected").iterdir())
    assert len(names) == 101
    assert (names[0][:6], names[-2][:6], names[-1]) == ("hmi005", "hmi104", "notes.txt")


@pytest.mark.parametrize("none", [False, True])
async def test_none_is_there_only_where_it_is_asked_for(tmp_path: Path, none: bool) -> None:
    async with serve_secured(tmp_path, none=none) as server:
        found = await server.served.client().connect_and_get_server_endpoints()
        modes = {(each.SecurityPolicyUri.rpartition("#")[2], each.SecurityMode.name) for each in found}
        policies = ("Basic256Sha256", "Aes128_Sha256_RsaOaep", "Aes256_Sha256_RsaPss")
        secured = {(policy, mode) for policy in policies for mode in ("Sign", "SignAndEncrypt")}
        assert modes == secured | ({("None", "None_")} if none else set())

        client = server.served.client()
        if none:
            async with client:
                assert await client.get_namespace_array()
        else:
            with pytest.raises(ua.UaStatusCodeError) as error:
                await client.connect()
            assert refused(error) == ua.StatusCodes.BadSecurityPolicyRejected


async def test_nothing_but_discovery_is_served_on_none_where_it_is_not_offered(server: Secured) -> None:
    client = server.served.client()
    await client.connect_sessionless()
    with pytest.raises(ua.UaStatusCodeError) as error:
        await client.create_session()

    assert refused(error) == ua.StatusCodes.BadSecurityPolicyRejected
    assert await client.get_endpoints()
    await client.disconnect_sessionless()


async def test_certificates_on_none_are_not_judged(tmp_path: Path) -> None:
    async with serve_secured(tmp_path, none=True) as server, node_client(tmp_path / "peer") as stranger:
        answer = await stranger.ask(connect=server.served.url)

        assert "namespaces" in answer
        assert list(server.rejected.iterdir()) == []
