"""asyncua's own server with many Doubles, to measure against."""

from asyncua import Server, ua


async def doubles_server(port: int, count: int, writable: int = 0) -> Server:
    """A server that is not yet started, with ns=1;s=D0 … in objects of 100; the first `writable` may be written."""
    server = Server()
    await server.init()
    server.set_endpoint(f"opc.tcp://127.0.0.1:{port}")
    server.set_security_policy([ua.SecurityPolicyType.NoSecurity])
    for first in range(0, count, 100):
        axis = await server.nodes.objects.add_object(ua.NodeId(f"A{first}", 1), f"1:A{first}")
        for number in range(first, min(first + 100, count)):
            variable = await axis.add_variable(ua.NodeId(f"D{number}", 1), f"1:D{number}", number + 0.5)
            if number < writable:
                await variable.set_writable()
    return server
