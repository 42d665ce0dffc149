"""The source's configuration: addresses are checked when it is loaded, and asyncua is not imported for it."""

import subprocess
import sys

import pytest
from pydantic import ValidationError

from softplc.drivers.opcua.config import OpcUaSource, OpcUaTag


def test_a_wrong_address_is_refused_when_the_configuration_is_loaded():
    with pytest.raises(ValidationError, match="is neither a node id nor a browse path; expected"):
        OpcUaTag(source="plc", node="AxisX.Position")


def test_a_secret_in_the_url_is_refused():
    with pytest.raises(ValidationError, match="expected them under user:"):
        OpcUaSource(type="opcua", name="plc", url="opc.tcp://operator:secret@127.0.0.1:4840")


@pytest.mark.parametrize("url", ["opc.tcp://h:99999", "opc.tcp://h:x", "opc.tcp://h:0", "opc.tcp://:4840"])
def test_an_address_without_proper_host_and_port_is_refused(url: str):
    with pytest.raises(ValidationError, match="is no host and port"):
        OpcUaSource(type="opcua", name="plc", url=url)


@pytest.mark.parametrize(
    ("url", "complete"),
    [
        ("opc.tcp://plc", "opc.tcp://plc:4840"),
        ("opc.tcp://plc/UA/Server", "opc.tcp://plc:4840/UA/Server"),
        ("opc.tcp://[::1]", "opc.tcp://[::1]:4840"),
        ("opc.tcp://plc:51210/UA", "opc.tcp://plc:51210/UA"),
    ],
)
def test_the_registered_port_is_used_where_none_is_named(url: str, complete: str):
    from softplc.drivers.opcua.session import with_port

    assert with_port(OpcUaSource(type="opcua", name="plc", url=url).url) == complete


def test_the_configuration_does_not_import_the_library():
    script = "import sys, softplc.drivers.opcua.config; print('asyncua' in sys.modules)"
    command = [sys.executable, "-c", script]

    assert subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip() == "False"
