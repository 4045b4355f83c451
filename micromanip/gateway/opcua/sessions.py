"""Sessions, each its owner's alone, with the subscriptions that are his.

asyncua 2.1 numbers the tokens by which a session is known, so that anybody guesses them, and lets each session delete
the subscriptions of all. What can't be sent again it sends empty, and Good: clients ask for it without end.
"""

from __future__ import annotations

import secrets
from collections.abc import Iterator, MutableMapping
from typing import Any

from asyncua import ua
from asyncua.common.utils import ServiceError
from asyncua.server.internal_server import InternalServer
from asyncua.server.internal_session import InternalSession
from asyncua.server.subscription_service import SubscriptionService

_FASTEST_MS, _SLOWEST_MS = 50.0, 3_600_000.0
"""Of what a client may ask its subscription to publish at: the cell's values come every 250 ms."""


class Host(InternalServer):  # type: ignore[misc]
    """That of asyncua, with sessions of ours."""

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

    def __init__(self, host: Host, space: Any, service: SubscriptionService, name: str, **options: Any) -> None:
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
