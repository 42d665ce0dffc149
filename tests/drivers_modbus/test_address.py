"""Addresses as people write them, and the errors that say what would be right."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from softplc.drivers.modbus.address import Address, Table, parse_address


@pytest.mark.parametrize(
    ("written", "table", "offset", "shown"),
    [
        (40001, Table.HOLDING, 0, "40001 / holding:0"),
        ("40001", Table.HOLDING, 0, "40001 / holding:0"),
        (400001, Table.HOLDING, 0, "40001 / holding:0"),
        (49999, Table.HOLDING, 9998, "49999 / holding:9998"),
        (410000, Table.HOLDING, 9999, "410000 / holding:9999"),
        (465536, Table.HOLDING, 65535, "465536 / holding:65535"),
        (30013, Table.INPUT, 12, "30013 / input:12"),
        ("300013", Table.INPUT, 12, "30013 / input:12"),
        (10008, Table.DISCRETE, 7, "10008 / discrete:7"),
        ("00004", Table.COIL, 3, "00004 / coil:3"),
        ("000004", Table.COIL, 3, "00004 / coil:3"),
        ("holding:0", Table.HOLDING, 0, "40001 / holding:0"),
        ("Holding: 0 ", Table.HOLDING, 0, "40001 / holding:0"),
        ("input:12", Table.INPUT, 12, "30013 / input:12"),
        ("coil:3", Table.COIL, 3, "00004 / coil:3"),
        ("discrete:7", Table.DISCRETE, 7, "10008 / discrete:7"),
        ("HR0", Table.HOLDING, 0, "40001 / holding:0"),
        ("ir12", Table.INPUT, 12, "30013 / input:12"),
        ("C3", Table.COIL, 3, "00004 / coil:3"),
        ("DI7", Table.DISCRETE, 7, "10008 / discrete:7"),
    ],
)
def test_every_notation_names_table_and_offset_and_is_shown_in_both(written, table, offset, shown):
    address = parse_address(written)

    assert (address.table, address.offset) == (table, offset)
    assert str(address) == shown


@pytest.mark.parametrize(
    ("written", "message"),
    [
        (40000, "40000 is outside 40001…49999: numbers count from 1, 40001 is holding:0"),
        ("400000", "'400000' is outside 400001…465536: numbers count from 1, 400001 is holding:0"),
        (465537, "465537 is outside 400001…465536: numbers count from 1, 400001 is holding:0"),
        (
            70000,
            "70000: first digit 7 names no table, "
            "expected 0 (coil), 1 (discrete), 3 (input) or 4 (holding), or a form such as holding:0",
        ),
        ("holding:70000", "'holding:70000': offset 70000 is outside 0…65535, expected 40001 / holding:0 to 465536"),
        ("holding:-1", "'holding:-1': offset -1 is outside 0…65535"),
        ("holdng:7", "'holdng:7': there is no table 'holdng', did you mean holding:7?"),
        ("q:7", "'q:7': there is no table 'q', expected one of coil, discrete, input, holding"),
        (12, "12 names no table, expected five or six digits such as 40001 or 400001, or holding:12 if it counts from 0"),
        (-5, "-5 names no table"),
        (4000001, "4000001 names no table, expected five or six digits"),
        ("DB1.DBD0", "'DB1.DBD0' is not a Modbus address, expected holding:0, input:12, coil:3, discrete:7, or a number"),
        ("", "'' is not a Modbus address"),
        ("I7", "'I7' is not a Modbus address"),
    ],
)
def test_what_is_no_address_is_refused_with_what_would_be_right(written, message):
    with pytest.raises(ValueError, match="expected|outside|did you mean") as error:
        parse_address(written)

    assert message in str(error.value)


@given(st.sampled_from(list(Table)), st.integers(0, 65535))
def test_both_shown_notations_read_back_as_the_same_address(table, offset):
    address = Address(table, offset)

    number, name = str(address).split(" / ")

    assert parse_address(number) == parse_address(name) == address
