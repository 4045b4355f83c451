"""What comes in on one connection: why its channel can't be opened, and whose session is spoken of on it.

asyncua 2.1 says nothing of a channel that it refuses, and leaves the connection open, so that the client waits for its
time-out: here a message ERR ends it, as OPC UA has it. And it takes a session over to another connection before that
has proven anything, and leaves it there where the proof fails.
"""

from __future__ import annotations

from typing import Any

from asyncua import ua
from asyncua.common.utils import ServiceError
from asyncua.server import binary_server_asyncio
from asyncua.server.uaprocessor import UaProcessor
from asyncua.ua.ua_binary import uatcp_to_binary


def _requests(*names: str) -> list[ua.NodeId]:
    return [ua.NodeId(getattr(ua.ObjectIds, f"{name}Request_Encoding_DefaultBinary")) for name in names]


_CREATE, _ACTIVATE = _requests("CreateSession", "ActivateSession")
_WITHOUT_SESSION = _requests("CreateSession", "GetEndpoints", "FindServers", "CloseSecureChannel")
_REGISTERING = _requests("RegisterServer", "RegisterServer2")
"""asyncua is a discovery server, too, and lists what anybody registers."""


class Processor(UaProcessor):  # type: ignore[misc]
    """That of asyncua, for one connection."""

    session: Any

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

    async def close(self) -> None:
        """The connection is over: what its client still waits for is kept for the connection that follows."""
        self._publish_requests.clear()
        await super().close()

    async def _process_message(self, typeid: Any, requesthdr: Any, seqhdr: Any, body: Any) -> Any:
        """One request. A connection has one session, and a session goes to another connection with its certificate."""
        before, certificate = self.session, self._connection.security_policy.peer_certificate
        if typeid in _REGISTERING:
            raise ServiceError(ua.StatusCodes.BadServiceUnsupported)
        if typeid == _CREATE and before is not None:
            if before.is_activated():
                raise ServiceError(ua.StatusCodes.BadTooManySessions)
            await before.close_session(True)
        elif typeid not in _WITHOUT_SESSION:
            told = before or self.iserver.lookup_external_session(requesthdr.AuthenticationToken)
            if told is None or told.auth_token != requesthdr.AuthenticationToken:
                raise ServiceError(ua.StatusCodes.BadSessionIdInvalid)
            if told.channel_certificate != certificate or (before is None and typeid != _ACTIVATE):
                raise ServiceError(ua.StatusCodes.BadSecurityChecksFailed)
        try:
            goes_on = await super()._process_message(typeid, requesthdr, seqhdr, body)
        except Exception:
            if before is None:
                self.session = None
            raise
        if typeid == _CREATE:
            self.session.channel_certificate = certificate
        return goes_on


def tell_why() -> None:
    """From now on, for all servers of this process: asyncua has no place where it asks for one."""
    binary_server_asyncio.UaProcessor = Processor
