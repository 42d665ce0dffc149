"""A body between stops: exact flights, and a contact that tells of every impact."""

import math
import time
from collections.abc import Iterator
from typing import Any

import pytest
from asyncua import Client
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError
from pymodbus.client import AsyncModbusTcpClient

from softplc.emulator import modbus_map
from softplc.emulator.bounce import Bounce
from softplc.emulator.plant import Plant
from tests.emulator.scenarios import Emulator, emulator, scenario

AXIS = {"velocity": 1.0, "upper": 2.0, "restitution": 0.8}
BALL = {"velocity": 5.0, "gravity": 10.0, "restitution": 0.5, "repeat_s": 4.0}


def bounce(**given: Any) -> Bounce:
    return Bounce(type="bounce", **given)


@pytest.mark.parametrize(
    ("t", "position", "velocity"),
    [
        (0.0, 0.0, 1.0),
        (1.5, 1.5, 1.0),
        (2.0, 2.0, -0.8),
        (3.25, 1.0, -0.8),
        (4.5, 0.0, 0.64),
        (7.625, 2.0, -0.512),
        (11.53125, 0.0, 1.0),  # the first time at the lower stop after 10 s: sent off again
        (13.03125, 1.5, 1.0),
    ],
)
def test_without_gravity_it_moves_at_constant_velocity_and_loses_at_each_stop(
    t: float, position: float, velocity: float
):
    assert bounce(**AXIS).at(t) == pytest.approx((position, velocity), abs=1e-12)


@pytest.mark.parametrize(
    ("t", "position", "velocity"),
    [
        (0.5, 1.25, 0.0),  # the top: v²/2g
        (1.0, 0.0, 2.5),
        (1.25, 0.3125, 0.0),
        (1.5, 0.0, 1.25),
        (3.9, 0.0, 0.0),  # its bounces are over after 2·v/(g(1 − κ)) = 2 s
        (4.5, 1.25, 0.0),
    ],
)
def test_with_gravity_it_is_a_ball_that_comes_to_rest(t: float, position: float, velocity: float):
    assert bounce(**BALL).at(t) == pytest.approx((position, velocity), abs=1e-9)


def test_a_ball_under_a_ceiling_hits_that_too():
    motion = bounce(velocity=5.0, gravity=10.0, upper=0.8, restitution=1.0)
    speed = math.sqrt(25.0 - 16.0)
    assert motion.at((5.0 - speed) / 10.0) == pytest.approx((0.8, -speed), abs=1e-9)


def test_restitution_0_under_gravity_stays_where_it_fell():
    motion = bounce(velocity=5.0, gravity=10.0, restitution=0.0, repeat_s=4.0)
    assert [motion.at(t) for t in (1.0, 2.5, 3.99)] == [(0.0, 0.0)] * 3
    assert all(motion.contact(t) for t in (1.0, 2.5, 3.99))


MOTIONS = [bounce(**AXIS), bounce(**BALL), bounce(velocity=7.0, gravity=3.0, upper=2.0, restitution=0.9)]


@pytest.mark.parametrize("motion", MOTIONS)
@given(t=st.floats(0.0, 1e4), dt=st.floats(0.0, 1.0))
def test_it_never_leaves_its_stops_and_never_jumps(motion: Bounce, t: float, dt: float):
    (before, _), (after, velocity) = motion.at(t), motion.at(t + dt)
    fastest = motion.velocity * (1 + 1e-9)
    assert motion.lower - 1e-9 <= after <= (motion.upper or math.inf) + 1e-9
    assert abs(velocity) <= fastest
    assert abs(after - before) <= fastest * dt + 1e-6  # time itself is rounded


def test_the_contact_closes_with_each_impact_and_opens_after_its_time():
    motion = bounce(**AXIS, contact_s=0.1)
    closed = [k / 100 for k in range(1200) if motion.contact(k / 100)]
    starts = [t for t in closed if t - 0.01 not in closed]
    # impacts at 2.0, 4.5, 7.625 and, where it is sent off again, 11.53125; not at the start
    assert [round(t, 2) for t in closed[:10]] == [round(2.0 + k / 100, 2) for k in range(10)]
    assert len(starts) >= 4
    assert not motion.contact(0.0)
    assert not motion.contact(0.05)
    assert [motion.contact(t) for t in (2.05, 2.15, 4.55, 7.7, 11.6, 11.7)] == [True, False, True, True, True, False]


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ({"velocity": 1.0}, "never come back"),
        ({"velocity": 1.0, "upper": -1.0}, "expected more than lower"),
        ({"velocity": 1.0, "upper": 1.0, "restitution": 0.0}, "stay at the upper stop"),
        ({"velocity": 1e6, "upper": 0.1, "restitution": 1.0}, "fewer than 10000 impacts"),
    ],
)
def test_a_motion_that_cannot_be_is_refused(given: dict[str, Any], text: str):
    with pytest.raises(ValidationError, match=text):
        bounce(**given)


PLC = scenario(
    {"name": "Still"},
    {"name": "Ball", "motion": {"type": "bounce", "contact_s": 0.4, **AXIS, "velocity": 4.0, "repeat_s": 1.0}},
    opcua={"port": 0},
    modbus={"port": 0},
)


@pytest.fixture(scope="module")
def plc() -> Iterator[Emulator]:
    with emulator(PLC) as running:
        yield running


async def test_the_contact_is_a_boolean_over_opcua_that_goes_with_its_step(plc: Emulator):
    plant, seen = Plant(PLC), set()
    async with Client(plc.endpoints["opcua"], timeout=30) as client:
        nodes = [client.get_node(f"ns=2;s={name}") for name in ("Heartbeat", "Ball.Contact", "Ball.TruePosition")]
        deadline = time.monotonic() + 30.0
        while seen != {True, False}:
            assert time.monotonic() < deadline
            heartbeat, contact, position = [value.Value.Value for value in await client.read_attributes(nodes)]
            state = plant.at(heartbeat).axes[1]
            assert (contact, position) == (state.contact, state.true_position)
            seen.add(contact)
        still = await client.get_node("ns=2;s=Still").get_children()
        assert "Contact" not in {(await node.read_browse_name()).Name for node in still}


async def test_the_contact_is_a_discrete_input_and_a_word_over_modbus(plc: Emulator):
    seen: set[bool] = set()
    async with AsyncModbusTcpClient("127.0.0.1", port=plc.port("modbus"), timeout=30) as client:
        deadline = time.monotonic() + 30.0
        while seen != {True, False}:
            assert time.monotonic() < deadline
            before = (await client.read_holding_registers(133, count=1, device_id=1)).registers[0]
            bits = (await client.read_discrete_inputs(2000, count=2, device_id=1)).bits[:2]
            after = (await client.read_holding_registers(133, count=1, device_id=1)).registers[0]
            if before == after:  # no step in between
                assert bits == [False, bool(before)]
                seen.add(bits[1])
        assert (await client.read_discrete_inputs(0, count=2, device_id=1)).bits[:2] == [True, True]  # Enable
        assert (await client.read_coils(2000, count=1, device_id=1)).isError()


def test_the_table_names_the_contact_of_an_axis_that_has_one():
    rows = {row.name: row for row in modbus_map.rows(PLC)}
    assert (rows["Ball.Contact"].table, rows["Ball.Contact"].offset, rows["Ball.Contact"].number) == (
        "discrete",
        2001,
        "12002",
    )
    assert rows["Ball.ContactWord"].offset == 133
    assert "Still.Contact" not in rows
