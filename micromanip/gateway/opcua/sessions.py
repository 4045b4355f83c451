"""Sessions and connections of OPC UA: each client has its own session, with its own subscriptions.

What asyncua 2.1 lacks is here. It numbers the tokens of sessions, so that anybody guesses them, and lets each session
delete the subscriptions of all. A message that can't be sent again it sends empty, and Good: clients ask for it without
end. It says nothing of a channel that it refuses, and leaves the connection open, so that the client waits for its
time-out: here a message ERR ends the connection, as OPC UA has it. It takes a session over to another connection before
that connection has proven anything, and leaves the session there where the proof fails.
"""

from __future__ import annotations

import secrets
from collections.abc import Iterator, MutableMapping
from typing import Any

from asyncua import ua
from asyncua.common.utils import ServiceError
from asyncua.server import binary_server_asyncio
from asyncua.server.internal_server import InternalServer
from asyncua.server.internal_session import InternalSession
from asyncua.server.subscription_service import SubscriptionService
from asyncua.server.uaprocessor import UaProcessor
from asyncua.ua.ua_binary import uatcp_to_binary

_FASTEST_MS, _SLOWEST_MS = 50.0, 3_600_000.0
"""Of what a client may ask its subscription to publish at: the cell's values come every 250 ms."""


class OwnedSessions(InternalServer):  # type: ignore[misc]
    """The server of asyncua, with sessions of ours."""

    def create_session(self, name: str, user: Any = None, external: bool = False) -> Session:
        """For a new client; `user` follows when it is activated."""
        made = Session(self, self.aspace, self.subscription_service, name, external=external)
        if user is not None:
            made.user = user
        return made

    def register_external_session(self, session: InternalSession) -> None:
        """Under a token that can't be guessed."""
        session.auth_token = ua.NodeId(secrets.token_bytes(32), 0, ua.NodeIdType.ByteString)
        super().register_external_session(session)


class Session(InternalSession):  # type: ignore[misc]
    """One client's; `channel_certificate` (DER) is what it came with, None without one."""

    channel_certificate: bytes | None = None

    def __init__(
        self, host: OwnedSessions, space: Any, service: SubscriptionService, name: str, **options: Any
    ) -> None:
        super().__init__(host, space, service, name, **options)
        self.subscription_service = _OwnSubscriptions(service, self.session_id)


class _OwnSubscriptions(SubscriptionService):  # type: ignore[misc]
    """The server's, as one session sees and changes them."""

    def __init__(self, every: SubscriptionService, session_id: ua.NodeId) -> None:
        super().__init__(every.aspace, every.iserver)
        self._every = every
        self.subscriptions = _Owned(every.subscriptions, session_id)

    async def create_subscription(self, params: Any, *arguments: Any, **options: Any) -> Any:
        asked_ms = params.RequestedPublishingInterval
        params.RequestedPublishingInterval = min(asked_ms, _SLOWEST_MS) if asked_ms >= _FASTEST_MS else _FASTEST_MS
        return await self._every.create_subscription(params, *arguments, **options)

    def republish(self, params: Any) -> Any:
        if params.SubscriptionId not in self.subscriptions:
            raise ServiceError(ua.StatusCodes.BadSubscriptionIdInvalid)
        message = super().republish(params)
        if not message.NotificationData:
            raise ServiceError(ua.StatusCodes.BadMessageNotAvailable)
        return message


class _Owned(MutableMapping[int, Any]):
    """Of all subscriptions, by their numbers, those of one session."""

    def __init__(self, every: dict[int, Any], session_id: ua.NodeId) -> None:
        self._every, self._session_id = every, session_id

    def __getitem__(self, number: int) -> Any:
        found = self._every[number]
        if found.session_id != self._session_id:
            raise KeyError(number)
        return found

    def __setitem__(self, number: int, made: Any) -> None:
        self._every[number] = made

    def __delitem__(self, number: int) -> None:
        del self._every[self[number].data.SubscriptionId]

    def __iter__(self) -> Iterator[int]:
        return (number for number, found in self._every.items() if found.session_id == self._session_id)

    def __len__(self) -> int:
        return sum(1 for _ in self)


def _requests(*names: str) -> list[ua.NodeId]:
    return [ua.NodeId(getattr(ua.ObjectIds, f"{name}Request_Encoding_DefaultBinary")) for name in names]


_CREATE, _ACTIVATE = _requests("CreateSession", "ActivateSession")
_WITHOUT_SESSION = _requests("CreateSession", "GetEndpoints", "FindServers", "CloseSecureChannel")
_REGISTERING = _requests("RegisterServer", "RegisterServer2")
"""asyncua is a discovery server, too, and lists what anybody registers."""


class Processor(UaProcessor):  # type: ignore[misc]
    """The requests of one connection."""

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
            asked = before or self.iserver.lookup_external_session(requesthdr.AuthenticationToken)
            if asked is None or asked.auth_token != requesthdr.AuthenticationToken:
                raise ServiceError(ua.StatusCodes.BadSessionIdInvalid)
            if asked.channel_certificate != certificate or (before is None and typeid != _ACTIVATE):
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


def use_own_processor() -> None:
    """From now on, for all servers of this process: asyncua has no option for it."""
    binary_server_asyncio.UaProcessor = Processor
