"""Why a channel can't be opened, said to the client as OPC UA has it: a message ERR, and the connection is over.

asyncua 2.1 says nothing and leaves such a connection open, so that the client waits for its time-out.
"""

from __future__ import annotations

from typing import Any

from asyncua import ua
from asyncua.server import binary_server_asyncio
from asyncua.server.uaprocessor import UaProcessor
from asyncua.ua.ua_binary import uatcp_to_binary


class Processor(UaProcessor):  # type: ignore[misc]
    """That of asyncua, for one connection."""

    async def process(self, header: Any, body: Any) -> Any:
        """Whether the connection goes on."""
        try:
            return await super().process(header, body)
        except Exception as problem:
            opens = header.MessageType == ua.MessageType.SecureOpen
            why = ua.StatusCodes.BadSecurityPolicyRejected if opens else ua.StatusCodes.BadCommunicationError
            code = getattr(problem, "code", why)
            said = ua.ErrorMessage(ua.StatusCode(code), str(problem)[:200])
            self._transport.write(uatcp_to_binary(ua.MessageType.Error, said))
            return False


def tell_why() -> None:
    """From now on, for all servers of this process: asyncua has no place where it asks for one."""
    binary_server_asyncio.UaProcessor = Processor
