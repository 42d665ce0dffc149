"""Signed and encrypted channels: the same service, the same limits, and nobody takes over anybody's session."""

import asyncio
import struct
from collections.abc import AsyncIterator
from typing import Any

import pytest
import pytest_asyncio
from asyncua import Client, ua
from asyncua.crypto.uacrypto import x509_from_der

from tests.publishers_opcua.certificates import HMI, POLICIES, Application, Secured, serve_secured
from tests.publishers_opcua.conftest import PASSWORD, NodeClient, Notifications, node_client
from tests.support.network import eventually

pytestmark = pytest.mark.asyncio(loop_scope="module")

VALUE = 13
GOOD_COMPLETES_ASYNCHRONOUSLY = 0x002E0000
OTHER = Application("other", pair="other")
MODES = [(policy, mode) for policy in POLICIES for mode in ("Sign", "SignAndEncrypt")]


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def server(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[Secured]:
    """Trusts two clients, and offers SecurityPolicy None as well."""
    async with serve_secured(tmp_path_factory.mktemp("secured"), none=True) as server:
        server.trust(HMI, OTHER)
        for tag in server.served.exchange.table:
            server.served.exchange.set(tag.name, 1.0)
        await server.served.scan()
        yield server


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def peer(server: Secured, tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[NodeClient]:
    """A node-opcua client whose certificate is trusted, not connected."""
    async with node_client(tmp_path_factory.mktemp("node-opcua")) as peer:
        server.served.clock.advance(60.0)  # it makes its certificate after the server's start
        answer = await peer.ask(connect=server.served.url, policy="Basic256Sha256", mode="Sign")
        assert "BadCertificateUntrusted" in answer["error"]
        for file in server.rejected.iterdir():
            file.rename(server.trusted / file.name)
        yield peer


def in_arrays(server: Secured) -> int:
    """How many Reads were answered out of the arrays."""
    return int(server.served.server._server.iserver.reads.served)


async def written(server: Secured, client: Client, value: bool) -> int:
    """Status of a write of AxisY.Enable, and that it came as a command."""
    node = client.get_node("ns=2;s=AxisY.Enable")
    item = ua.WriteValue(node.nodeid, ua.AttributeIds.Value, Value=ua.DataValue(ua.Variant(value)))
    [status] = await client.uaclient.write(ua.WriteParameters([item]))
    if status.is_good():
        table = server.served.exchange.table
        assert server.served.exchange.writer.commands() == [(table.index("AxisY.Enable"), float(value))]
    return int(status.value)


@pytest.mark.parametrize(("policy", "mode"), MODES)
async def test_reads_writes_and_subscriptions_work_on_every_policy(server: Secured, policy: str, mode: str) -> None:
    served = server.served
    async with server.client(HMI, policy, mode, user="engineer") as client:
        served.exchange.set("AxisX.Position", 10.0)
        await served.scan()
        assert await client.get_node("ns=2;s=AxisX.Position").read_value() == 10.0
        assert await written(server, client, False) == GOOD_COMPLETES_ASYNCHRONOUSLY

        seen = Notifications()
        subscription = await client.create_subscription(20, seen)
        await subscription.subscribe_data_change(client.get_node("ns=2;s=AxisX.Position"))
        for number in (11.0, 12.0):
            served.exchange.set("AxisX.Position", number)
            await served.scan()
            await eventually(lambda number=number: number in seen.numbers(), what=f"{number} notified")


@pytest.mark.parametrize(("policy", "mode"), MODES[1::2] + MODES[:1])
async def test_node_opcua_reads_writes_and_subscribes(
    server: Secured, peer: NodeClient, policy: str, mode: str
) -> None:
    served = server.served
    await served.scan()
    snapshot = served.exchange.reader.snapshot()
    how = {"connect": served.url, "policy": policy, "mode": mode, "user": "engineer", "password": PASSWORD}
    assert "namespaces" in await peer.ask(**how)
    before = in_arrays(server)
    samples = (await peer.ask(read=[[f"ns=2;s={tag.name}", VALUE] for tag in served.exchange.table] * 30))["samples"]
    assert in_arrays(server) == before + 1
    assert len(samples) > 2000
    assert [sample["value"] for sample in samples] == list(snapshot.values) * 30

    answer = await peer.ask(write=["ns=2;s=AxisY.Enable", VALUE, "Boolean", True])
    assert answer["status"] == GOOD_COMPLETES_ASYNCHRONOUSLY
    served.exchange.writer.commands()
    await heard(served, peer)
    await peer.ask(disconnect=True)


async def heard(served: Any, peer: NodeClient) -> None:
    """Every change of a tag comes to the peer."""
    peer.notifications.clear()
    await peer.ask(subscribe=["ns=2;s=AxisX.Velocity"], interval=20)
    for number in (21.0, 22.0, 23.0):
        served.exchange.set("AxisX.Velocity", number)
        await served.scan()
        await peer.notified(lambda seen, number=number: bool(seen) and seen[-1]["value"] == number)


async def test_a_secured_client_whose_line_was_cut_hears_of_changes_again(server: Secured, peer: NodeClient) -> None:
    served = server.served
    how = {"connect": served.url, "policy": "Basic256Sha256", "mode": "SignAndEncrypt", "retries": 20}
    assert "namespaces" in await peer.ask(**how)
    await heard(served, peer)

    for connection in list(served.server._listener.clients):
        connection.transport.abort()

    served.exchange.set("AxisX.Velocity", 31.0)
    await served.scan()
    await peer.notified(lambda seen: seen[-1]["value"] == 31.0)
    await peer.ask(disconnect=True)


async def test_a_large_answer_is_cut_into_chunks_and_the_same_as_in_clear(server: Secured) -> None:
    nodes = [ua.ReadValueId(ua.NodeId(tag.name, 2), VALUE) for tag in server.served.exchange.table] * 60
    answers = []
    for client in (server.client(), server.client(mode="Sign"), server.served.client()):
        async with client:
            before = in_arrays(server)
            answers.append(await client.uaclient.read(ua.ReadParameters(NodesToRead=nodes[:5000])))
            assert in_arrays(server) == before + 1

    assert len(answers[0]) > 3000
    assert answers[0] == answers[1] == answers[2]


async def test_values_go_on_while_tokens_are_renewed(server: Secured) -> None:
    async with server.client() as client:
        node = client.get_node("ns=2;s=AxisX.Raw")
        for number in range(6):
            server.served.exchange.set("AxisX.Raw", float(number))
            await server.served.scan()
            reads = [asyncio.ensure_future(node.read_value()) for _ in range(20)]
            await client.open_secure_channel(renew=True)
            assert [*await asyncio.gather(*reads), await node.read_value()] == [float(number)] * 21


@pytest.mark.parametrize("mode", ["Sign", "SignAndEncrypt", None])
async def test_a_password_logs_in_and_a_wrong_one_does_not(server: Secured, mode: str | None) -> None:
    for password, status in ((PASSWORD, "Good"), ("guessed", "BadIdentityTokenRejected")):
        client = server.served.client() if mode is None else server.client(mode=mode)
        client.set_user("engineer")
        client.set_password(password)
        try:
            async with client:
                found = "Good"
                assert await written(server, client, True) == GOOD_COMPLETES_ASYNCHRONOUSLY
        except ua.UaStatusCodeError as error:
            found = type(error).__name__
        assert found == status


class Opened:
    """A client with a channel, and unless told otherwise a session that is not activated yet."""

    def __init__(self, client: Client, *, session: bool = True) -> None:
        self.client, self.session = client, session

    async def __aenter__(self) -> Client:
        await self.client.connect_socket()
        await self.client.send_hello()
        await self.client.open_secure_channel()
        if self.session:
            await self.client.create_session()
        return self.client

    async def __aexit__(self, *_: object) -> None:
        self.client.disconnect_socket()


def in_clear(password: bytes) -> ua.UserNameIdentityToken:
    return ua.UserNameIdentityToken(PolicyId="username", UserName="engineer", Password=password)


async def activated(client: Client, token: Any) -> str:
    """Name of the status of ActivateSession with this token."""
    parameters = ua.ActivateSessionParameters(UserIdentityToken=token)
    challenge = client.security_policy.peer_certificate or b""
    if challenge:
        signature = client.security_policy.asymmetric_cryptography.signature(challenge + client._server_nonce)
        parameters.ClientSignature = ua.SignatureData(client.security_policy.AsymmetricSignatureURI, signature)
    try:
        await client.uaclient.activate_session(parameters)
    except ua.UaStatusCodeError as error:
        return type(error).__name__
    return "Good"


@pytest.mark.parametrize(
    ("mode", "status"), [("Sign", "BadIdentityTokenInvalid"), ("SignAndEncrypt", "Good"), (None, "Good")]
)
async def test_a_password_in_clear_is_taken_where_the_channel_hides_it_or_nothing_is_hidden(
    server: Secured, mode: str | None, status: str
) -> None:
    async with Opened(server.served.client() if mode is None else server.client(mode=mode)) as client:
        assert await activated(client, in_clear(PASSWORD.encode())) == status


async def test_a_password_that_was_encrypted_for_another_session_is_worth_nothing(server: Secured) -> None:
    policy = POLICIES["Basic256Sha256"]
    async with Opened(server.client(mode="Sign")) as first, Opened(server.client(mode="Sign")) as second:
        nonce = first._server_nonce
        plain = struct.pack("<I", len(PASSWORD) + len(nonce)) + PASSWORD.encode() + nonce
        public = x509_from_der(first.security_policy.peer_certificate).public_key()
        token = in_clear(policy.encrypt_asymmetric(public, plain))
        token.EncryptionAlgorithm = policy.AsymmetricEncryptionURI

        assert await activated(second, token) == "BadIdentityTokenInvalid"
        assert await activated(first, token) == "Good"


async def test_a_session_is_bound_to_certificate_policy_and_mode(server: Secured) -> None:
    async with server.client() as owner:
        token = owner.uaclient.protocol.authentication_token
        thieves = {
            "another client": server.client(OTHER),
            "another mode": server.client(mode="Sign"),
            "another policy": server.client(policy="Aes256_Sha256_RsaPss"),
            "in clear": server.served.client(),
        }
        for who, thief in thieves.items():
            async with Opened(thief, session=False):
                thief.uaclient.protocol.authentication_token = token
                thief._server_nonce = owner._server_nonce
                assert (who, await activated(thief, ua.AnonymousIdentityToken())) == (who, "BadSecurityChecksFailed")
        assert await owner.get_namespace_array()
        async with Opened(server.client(), session=False) as again:
            again.uaclient.protocol.authentication_token = token
            again._server_nonce = owner._server_nonce
            assert await activated(again, ua.AnonymousIdentityToken()) == "Good"


async def test_a_session_without_the_proof_of_its_key_is_refused(server: Secured) -> None:
    async with Opened(server.client()) as client:
        client._server_nonce = bytes(32)  # the signature is over something else

        assert await activated(client, ua.AnonymousIdentityToken()) == "BadApplicationSignatureInvalid"
