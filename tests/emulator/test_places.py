"""Where the emulated PLC says that its axes are: as configurations have it, short, and right over both protocols."""

from softplc.cli.emulated import block, facts
from softplc.emulator.places import Place, places
from tests.emulator.scenarios import scenario

BOTH = {"opcua": {"port": 0}, "modbus": {"port": 0}}
BOUNCE = {"name": "Slide", "motion": {"type": "bounce", "velocity": 100.0, "upper": 200.0}}
SHOWN = [("opcua", "opc.tcp://127.0.0.1:4841"), ("modbus", "tcp://127.0.0.1:5021")]


def test_position_is_always_there_contact_and_the_plcs_own_estimate_where_they_are_served():
    chosen = scenario({"name": "AxisX", "aoi": {}}, BOUNCE, **BOTH)

    assert places(chosen) == [
        Place("AxisX", "Position", "ns=2;s=AxisX.Position", "holding:100", "float32"),
        Place("AxisX", "y", "ns=2;s=AxisX.y", "holding:116", "float32"),
        Place("AxisX", "y_dot", "ns=2;s=AxisX.y_dot", "holding:118", "float32"),
        Place("Slide", "Position", "ns=2;s=Slide.Position", "holding:120", "float32"),
        Place("Slide", "Contact", "ns=2;s=Slide.Contact", "discrete:2001", "bool"),
    ]


def test_what_is_printed_is_one_line_for_each_value():
    assert block("emulated PLC x.yaml", scenario({"name": "AxisX"}, BOUNCE, **BOTH), SHOWN) == [
        "emulated PLC x.yaml",
        "  opcua    opc.tcp://127.0.0.1:4841",
        "  modbus   tcp://127.0.0.1:5021",
        "  axis     AxisX  Position  ns=2;s=AxisX.Position  holding:100 float32",
        "  axis     Slide  Position  ns=2;s=Slide.Position  holding:120 float32",
        "                  Contact   ns=2;s=Slide.Contact   discrete:2001 bool",
        "Ctrl-C stops",
    ]


def test_only_what_is_served_is_printed_and_another_byte_order_is_told():
    chosen = scenario({"name": "AxisX"}, modbus={"port": 0, "byte_order": "CDAB"})

    assert block("x", chosen, SHOWN[1:])[1:-1] == [
        "  modbus   tcp://127.0.0.1:5021   byte_order: CDAB",
        "  axis     AxisX  Position  holding:100 float32",
    ]
    assert block("x", scenario({"name": "A"}, opcua={"port": 0}), SHOWN[:1])[2] == (
        "  axis     A  Position  ns=2;s=A.Position"
    )


def test_of_many_axes_eight_are_printed_and_the_data_have_them_all():
    chosen = scenario(*({"name": f"A{number}"} for number in range(100)), **BOTH)

    lines = block("x", chosen, SHOWN)
    assert len([line for line in lines if "Position" in line]) == 8
    assert lines[-2].strip() == "and 92 more, 20 registers apart"
    found = facts(chosen, SHOWN)
    assert found["modbus"] == "tcp://127.0.0.1:5021"
    assert found["axes"]["A99"] == {
        "Position": {"node": "ns=2;s=A99.Position", "address": "holding:2080", "data_type": "float32"}
    }
