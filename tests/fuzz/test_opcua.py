"""OPC-UA messages that nobody should send, and the server that goes on as if nobody had."""

import random

import pytest

from tests.fuzz.opcua import MUTANTS, SOCKETS, hosted, known_cases, run
from tests.fuzz.opcua_messages import Channel, Message, corpus, frame, frames, parse
from tests.fuzz.opcua_mutate import mutate, mutate_frame


def test_the_corpus_has_whole_conversations_of_two_independent_clients() -> None:
    services = {message.service.removesuffix("Request") for message in corpus()}

    assert services >= {
        "Hello", "OpenSecureChannel", "CreateSession", "ActivateSession", "CloseSession", "GetEndpoints",
        "FindServers", "Read", "Write", "Browse", "BrowseNext", "TranslateBrowsePathsToNodeIds", "Call",
        "HistoryRead", "CreateSubscription", "ModifySubscription", "SetPublishingMode", "Publish", "Republish",
        "TransferSubscriptions", "DeleteSubscriptions", "CreateMonitoredItems", "ModifyMonitoredItems",
        "SetMonitoringMode", "DeleteMonitoredItems", "RegisterServer", "AddNodes",
    }  # fmt: skip


def test_a_recorded_message_is_the_same_message_on_another_channel() -> None:
    channel = Channel(channel=5, token=13, session=b"s" * 32, subscription=b"\x01\x02\x03\x04")
    for message in corpus():
        if message.kind == b"MSG":
            (sent,) = frames(channel.message(channel.fill(message.body)))
            again = parse(sent)
            assert (again.service, again.payload, len(again.body)) == (
                message.service, message.payload, len(message.body)
            )  # fmt: skip


def test_chunks_put_together_are_the_message() -> None:
    message = Message("Read", b"MSG", bytes(range(100)))
    chunks = list(frames(Channel().message(message.body, cuts=(30, 70))))

    assert [chunk[3:4] for chunk in chunks] == [b"C", b"C", b"F"]
    assert message.body == b"".join(chunk[24:] for chunk in chunks)


def test_the_same_seed_makes_the_same_mutants() -> None:
    messages = [message for message in corpus() if message.kind == b"MSG"]

    def made(seed: int) -> list[bytes]:
        chance = random.Random(seed)
        bodies = [mutate(chance.choice(messages), messages, chance) for _ in range(200)]
        return [*bodies, *(mutate_frame(frame(b"MSG", body), chance) for body in bodies)]

    assert made(1) == made(1)
    assert made(1) != made(2)


async def test_what_was_found_once_is_never_unexpected_again() -> None:
    cases = known_cases()
    assert len(cases) > 10
    async with hosted() as host:
        answer = await host.ask(replay=cases)

    assert answer["surprises"] == []


@pytest.mark.fuzz
@pytest.mark.timeout(600)  # half a minute where nobody else wants the processor
async def test_fifty_thousand_mutants_harm_neither_the_server_nor_another_client() -> None:
    outcome = await run(MUTANTS, SOCKETS, seed=4840)

    assert outcome.faults() == []
