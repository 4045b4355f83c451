"""The OPC UA server beside the web pages: it shows what the gateway knows, and passes orders on to the controller.

It speaks to the control socket only, as the pages do; what a controller refuses a client hears as BadInvalidState, and
as an event that says why.
"""

from __future__ import annotations

import asyncio
import contextlib
import contextvars
import datetime
import importlib.metadata
import logging
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any

from asyncua import Server, ua
from asyncua.server.event_generator import EventGenerator

from micromanip.errors import MicromanipError
from micromanip.status_reply import Fault

from ..cell import Cell
from .nodes import MANUFACTURER, Nodes, readings
from .sessions import OwnedSessions, use_own_processor
from .users import APPLICATION_URI, CellUser, RateLimitedLog, Rules, Users, prepared_folder

NAMESPACE = "urn:micromanip:cell"
_NAME = "micromanip gateway"
_ORDERS = {"Arm": "arm", "Hold": "hold", "Disarm": "disarm", "Reset": "reset"}
_SEVERITY = {"fault": 900, "refused": 500, "state": 200}
"""Of 1 to 1000, as the standard has it."""
_MOST_CONNECTIONS = 50


class OpcUa:
    """One server; `serving` is its life."""

    def __init__(
        self, cell: Cell, host: str, port: int, folder: Path, say: Callable[[str], None], *, is_local: bool
    ) -> None:
        """Raises what `prepared_folder` does. Where `is_local` everybody may look, unencrypted.

        `say` hears who was sent away, and why.
        """
        self._cell, self.url = cell, f"opc.tcp://{f'[{host}]' if ':' in host else host}:{port}/micromanip"
        self.own = prepared_folder(folder)
        self._users = Users(folder, RateLimitedLog(say), strangers_observe=is_local)
        self._is_local = is_local
        self._speaking: contextvars.ContextVar[CellUser] = contextvars.ContextVar("speaking")
        self._fresh = asyncio.Event()
        self._events: dict[str, EventGenerator] = {}
        self._state: str | None = None
        self._faults: set[tuple[str, str | None, int | None]] = set()

    @contextlib.asynccontextmanager
    async def serving(self) -> AsyncIterator[None]:
        """Serve meanwhile."""
        logging.getLogger("asyncua").setLevel(logging.CRITICAL)  # what a client does wrong is its own affair
        use_own_processor()
        server = Server(OwnedSessions(self._users))
        await server.init()
        server.iserver.max_connections = _MOST_CONNECTIONS
        server.set_endpoint(self.url)
        server.set_server_name(_NAME)
        await server.set_application_uri(APPLICATION_URI)
        encrypted = ua.SecurityPolicyType.Aes256Sha256RsaPss_SignAndEncrypt
        policies = [ua.SecurityPolicyType.NoSecurity, encrypted] if self._is_local else [encrypted]
        server.set_security_policy(policies, permission_ruleset=Rules(self._speaking))
        server.set_identity_tokens([ua.AnonymousIdentityToken, ua.X509IdentityToken])
        await server.load_certificate(self.own.certificate, "pem")
        await server.load_private_key(self.own.key, format="pem")
        index = await server.register_namespace(NAMESPACE)
        cell = await server.nodes.objects.add_object(ua.NodeId("cell", index), ua.QualifiedName("Cell", index))
        await cell.set_event_notifier([ua.EventNotifier.SubscribeToEvents])
        nodes = Nodes(server, index, cell)
        for name, verb in _ORDERS.items():
            await cell.add_method(ua.NodeId(f"cell/{name}", index), ua.QualifiedName(name, index), self._order(verb))
        await self._make_events(server, index, cell)
        version = importlib.metadata.version("micromanip")
        built = datetime.datetime.fromtimestamp(Path(__file__).stat().st_mtime, datetime.UTC)
        await server.set_build_info(APPLICATION_URI, MANUFACTURER, _NAME, version, version, built)
        await nodes.show(readings(self._cell, version))
        self._cell.listeners.add(self._heard)
        async with server:
            showing = asyncio.create_task(self._show(nodes, version))
            try:
                yield
            finally:
                self._cell.listeners.discard(self._heard)
                showing.cancel()
                with contextlib.suppress(asyncio.CancelledError):
                    await showing

    async def _make_events(self, server: Server, index: int, cell: Any) -> None:
        text, number = ua.VariantType.String, ua.VariantType.Double
        fields = {
            "fault": [("Code", text), ("Axis", text), ("Value", number), ("Limit", number), ("NextStep", text)],
            "state": [("From", text), ("To", text)],
            "refused": [("Order", text), ("Person", text)],
        }
        for kind, properties in fields.items():
            name = f"{kind.capitalize()}EventType"
            made = await server.create_custom_event_type(index, name, ua.ObjectIds.BaseEventType, properties)
            self._events[kind] = await server.get_event_generator(made, cell)

    def _heard(self, rows: Any) -> None:
        if rows is None:
            self._fresh.set()

    async def _show(self, nodes: Nodes, version: str) -> None:
        while True:
            await self._fresh.wait()
            self._fresh.clear()
            await nodes.show(readings(self._cell, version))
            await self._emit_events()

    async def _emit_events(self) -> None:
        """Events of what has changed since the last status."""
        status = self._cell.status
        if status is None:
            self._state, self._faults = None, set()
            return
        if self._state is not None and self._state != status["state"]:
            said = f"{self._state} -> {status['state']}"
            await self._event("state", said, From=self._state, To=status["state"])
        self._state = status["state"]
        latched = {(fault["code"], fault["axis"], fault["cycle"]): fault for fault in status["fault_reports"]}
        for key in latched.keys() - self._faults:
            await self._event("fault", latched[key]["seen"], **_fields(latched[key]))
        self._faults = set(latched)

    async def _event(self, kind: str, message: str, **fields: Any) -> None:
        generator = self._events[kind]
        generator.event.Severity = _SEVERITY[kind]
        for name, value in fields.items():
            setattr(generator.event, name, value)
        await generator.trigger(message=message)

    def _order(self, verb: str) -> Callable[..., Any]:
        async def call(_parent: ua.NodeId, *_arguments: Any) -> ua.CallMethodResult:
            result, user = ua.CallMethodResult(), self._speaking.get()
            try:
                await self._cell.order(verb, user.name or "somebody")
            except MicromanipError as problem:
                result.StatusCode = ua.StatusCode(ua.StatusCodes.BadInvalidState)
                await self._event("refused", str(problem), Order=verb, Person=user.name or "")
            return result

        return call


def _fields(fault: Fault) -> dict[str, Any]:
    return {
        "Code": fault["code"],
        "Axis": fault["axis"] or "",
        "Value": float("nan") if fault["value"] is None else fault["value"],
        "Limit": float("nan") if fault["limit"] is None else fault["limit"],
        "NextStep": fault["next_step"],
    }
