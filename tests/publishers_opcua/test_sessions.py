"""Sessions: how many, and that nobody gets at somebody else's."""

import contextlib

import pytest
from asyncua import ua

from softplc.publishers.opcua.hardened.limits import Limits
from tests.publishers_opcua.conftest import LIMITS, Served, connections, refused, serve

pytestmark = pytest.mark.asyncio(loop_scope="module")

CODES = ua.StatusCodes


async def test_one_connection_has_one_session(quiet: Served) -> None:
    async with quiet.client() as client:
        with pytest.raises(ua.UaStatusCodeError) as error:
            await client.create_session()

        assert CODES.BadTooManySessions == refused(error)
        assert len(quiet.server._server.iserver._external_sessions) == 1


async def test_a_lost_session_gives_way_to_a_new_client_and_a_living_one_does_not(quiet: Served) -> None:
    sessions = quiet.server._server.iserver._external_sessions
    async with contextlib.AsyncExitStack() as stack:
        for _ in range(LIMITS.sessions_per_address):
            await stack.enter_async_context(quiet.client())
        with pytest.raises(ua.UaStatusCodeError) as error:
            await quiet.client().connect()
        assert CODES.BadTooManySessions == refused(error)
        await connections(quiet, LIMITS.sessions_per_address)
        next(iter(sessions.values())).processor = None  # as after a cut line with a subscription

        async with quiet.client() as newcomer:
            assert await newcomer.get_namespace_array()
            assert LIMITS.sessions_per_address == len(sessions)


async def test_session_tokens_are_256_random_bits(quiet: Served) -> None:
    tokens = set()
    for _ in range(3):
        async with quiet.client() as client:
            token = client.uaclient.protocol.authentication_token
            assert (ua.NodeIdType.ByteString, 32) == (token.NodeIdType, len(token.Identifier))
            tokens.add(token.Identifier)

    assert len(tokens) == 3


async def test_a_session_answers_only_to_its_own_token(quiet: Served) -> None:
    async with quiet.client() as client:
        own = client.uaclient.protocol.authentication_token
        client.uaclient.protocol.authentication_token = ua.NodeId(bytes(32), 0, ua.NodeIdType.ByteString)
        with pytest.raises(ua.UaStatusCodeError) as error:
            await client.get_namespace_array()
        client.uaclient.protocol.authentication_token = own

        assert CODES.BadSessionIdInvalid == refused(error)
        assert await client.get_namespace_array()


async def test_a_guessed_token_takes_over_no_session(quiet: Served) -> None:
    async with quiet.client() as victim:
        thief = quiet.client()
        await thief.connect_sessionless()
        for guess in (ua.NodeId(1001), ua.NodeId(bytes(32), 0, ua.NodeIdType.ByteString), ua.NodeId()):
            thief.uaclient.protocol.authentication_token = guess
            with pytest.raises(ua.UaStatusCodeError) as error:
                await thief.uaclient.activate_session(ua.ActivateSessionParameters())
            assert CODES.BadSessionIdInvalid == refused(error)
        await thief.disconnect_sessionless()

        assert await victim.get_namespace_array()


async def test_a_session_moves_to_a_new_connection_and_leaves_the_old_one(quiet: Served) -> None:
    old, new = quiet.client(), quiet.client()
    await old.connect()
    await new.connect_sessionless()
    new.uaclient.protocol.authentication_token = old.uaclient.protocol.authentication_token

    await new.activate_session()

    assert await new.get_namespace_array()
    with pytest.raises(ua.UaStatusCodeError) as error:
        await old.get_namespace_array()
    assert CODES.BadSessionIdInvalid == refused(error)
    old.uaclient.protocol.transport.abort()
    with contextlib.suppress(Exception):
        await old.disconnect()
    await connections(quiet, 1)
    assert await new.get_namespace_array()  # the old connection did not take the session with it
    await new.disconnect()


async def test_a_wrong_password_on_a_new_connection_leaves_nothing_behind(quiet: Served) -> None:
    async with quiet.client() as owner:
        other = quiet.client()
        await other.connect_sessionless()
        other.uaclient.protocol.authentication_token = owner.uaclient.protocol.authentication_token
        with pytest.raises(ua.UaStatusCodeError) as error:
            await other.activate_session(username="engineer", password="wrong")
        assert CODES.BadIdentityTokenRejected == refused(error)
        with pytest.raises(ua.UaStatusCodeError):
            await other.get_namespace_array()
        await other.disconnect_sessionless()

        assert await owner.get_namespace_array()


async def test_all_sessions_together_are_limited() -> None:
    async with serve(Limits(sessions=1)) as served, served.client():
        with pytest.raises(ua.UaStatusCodeError) as error:
            await served.client().connect()

        assert refused(error) == CODES.BadTooManySessions


async def test_a_session_timeout_that_is_no_number_is_revised(quiet: Served) -> None:
    client = quiet.client()
    client.session_timeout = float("nan")
    async with client:
        (session,) = quiet.server._server.iserver._external_sessions.values()

        assert session.session_timeout == 5.0


@pytest.mark.parametrize("certificate", [b"no certificate at all", b"\x30\x82" + bytes(1000), bytes(8000)])
async def test_what_a_client_sends_as_its_certificate_is_not_judged_without_security(
    quiet: Served, certificate: bytes
) -> None:
    client = quiet.client()
    client.security_policy.host_certificate = certificate
    client.uaclient.security_policy.host_certificate = certificate

    async with client:
        assert await client.get_namespace_array()


async def test_a_certificate_is_nobodys_log_in(quiet: Served) -> None:
    async with quiet.client() as client:
        token = ua.X509IdentityToken(PolicyId="certificate", CertificateData=b"anything")
        with pytest.raises(ua.UaStatusCodeError) as error:
            await client.uaclient.activate_session(ua.ActivateSessionParameters(UserIdentityToken=token))

        assert CODES.BadIdentityTokenRejected == refused(error)
