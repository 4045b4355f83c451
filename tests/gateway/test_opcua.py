"""The cell by OPC UA, as asyncua's client sees it on a real socket: values, orders, events, and who is sent away."""

import asyncio
import contextlib
import math

import pytest

pytest.importorskip("asyncua")

from asyncua import Client, ua
from asyncua.crypto.security_policies import SecurityPolicyAes256Sha256RsaPss as Encrypted
from asyncua.crypto.security_policies import SecurityPolicyBasic256Sha256 as Basic256Sha256

from micromanip.errors import ConfigError, PermissionDenied
from micromanip.gateway.cell import Cell
from micromanip.gateway.opcua.service import NAMESPACE, OpcUa
from micromanip.gateway.opcua.users import prepared_folder
from tests.cli.played import FAULT
from tests.cli.played import Played as PlayedSocket

from .beside import Beside, free_port
from .certificates import certificate
from .rings import status

pytestmark = pytest.mark.live  # a server, and clients with time-outs

DENIED = (ua.UaError, ConnectionError, TimeoutError, asyncio.IncompleteReadError)


class Served(Beside):
    """An OPC UA server before a cell whose status the test says."""

    def __init__(self, folder, *, is_local):
        self.folder, cell = folder / "opcua", Cell(folder / "control.sock")
        self.played = PlayedSocket(folder / "control.sock")
        self.lines = []
        self.server = OpcUa(cell, "127.0.0.1", free_port(), self.folder, self.lines.append, is_local=is_local)
        self.people = folder
        for scope, name in (("operate", "ana"), ("observe", "ben")):
            public, _ = certificate(folder, name)
            (self.folder / scope / f"{name}.pem").write_bytes(public.read_bytes())
        super().__init__(cell, self.server)

    def close(self):
        super().close()
        self.played.close()


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    made = Served(tmp_path_factory.mktemp("opcua"), is_local=True)
    yield made
    made.close()


@pytest.fixture(scope="module")
def remote(tmp_path_factory):
    made = Served(tmp_path_factory.mktemp("remote"), is_local=False)
    yield made
    made.close()


@contextlib.asynccontextmanager
async def client(served, name=None, key=None, as_user=None, patience_s=60.0):
    """With the certificate of `name` on the channel and, where no other is given, as the user's."""
    made = Client(served.server.url, timeout=patience_s)
    made.application_uri = "urn:test:client"
    if name is not None:
        public, private = served.people / f"{name}.pem", key or served.people / f"{name}-key.pem"
        mode = ua.MessageSecurityMode.SignAndEncrypt
        await made.set_security(Encrypted, public, private, None, served.folder / "server.pem", mode)
        await made.load_client_certificate(as_user or public)
        await made.load_private_key(private)
    async with made:
        yield made


async def node(made, path):
    index = await made.get_namespace_index(NAMESPACE)
    return made.get_node(ua.NodeId(f"cell/{path}", index))


async def value(made, path):
    return await (await node(made, path)).read_value()


async def eventually(look, wanted):
    for _ in range(3000):
        with contextlib.suppress(ua.UaStatusCodeError):
            if (found := await look()) == wanted:
                return
        await asyncio.sleep(0.02)
    raise AssertionError(f"{found} is not {wanted}")


async def call(made, order):
    cell = made.get_node(ua.NodeId("cell", await made.get_namespace_index(NAMESPACE)))
    await cell.call_method(await node(made, order))


def test_values_have_units_and_times_and_those_that_are_not_known_say_so(served):
    async def seen():
        told = status()
        told["axes"]["x"] = told["axes"]["x"] | {
            "position_um": {"latest": None, "unknown": "stale", "second": None, "minute": None}
        }
        served.say(told)
        async with client(served) as made:
            await eventually(lambda: value(made, "Monitoring/Axes/y/Position"), 51.25)
            assert await value(made, "Monitoring/Axes/y/ErrorRmsLastMinute") == 0.5
            assert await value(made, "Monitoring/State") == "TRACKING"
            assert await value(made, "Monitoring/MachineTool/OperationMode") == 1
            assert await value(made, "Monitoring/Timing/LatenessP99_9") == 3.0
            assert await value(made, "Identification/ConfigurationSha256") == "0" * 64
            unit = await value(made, "Monitoring/Axes/y/Position/EngineeringUnits")
            assert unit.DisplayName.Text == "µm"
            assert unit.UnitId.to_bytes(2, "big") == b"4H"
            unknown = await (await node(made, "Monitoring/Axes/x/Position")).read_data_value(raise_on_bad_status=False)
            assert unknown.StatusCode.name == "BadNoData"
            served.say(None)
            await eventually(lambda: value(made, "Monitoring/Connected"), False)
            lost = await (await node(made, "Monitoring/Axes/y/Position")).read_data_value(raise_on_bad_status=False)
            assert lost.StatusCode.name == "BadNoCommunication"
            assert await value(made, "Monitoring/Problem") == "no controller answers"

    asyncio.run(seen())


@pytest.mark.parametrize("order", ["Arm", "Hold", "Disarm", "Reset"])
def test_who_may_operate_gives_orders_in_his_name(served, order):
    served.played.orders.clear()

    async def asked():
        async with client(served, "ana") as made:
            await call(made, order)

    asyncio.run(asked())
    assert served.played.orders == [order.lower()]


@pytest.mark.parametrize("name", [None, "ben"])
def test_who_may_not_operate_is_refused_and_nothing_is_asked_for(served, name):
    served.played.orders.clear()

    async def asked():
        async with client(served, name) as made:
            assert await value(made, "Monitoring/Connected") in (True, False)
            for order in ("Arm", "Reset"):
                with pytest.raises(ua.UaStatusCodeError):
                    await call(made, order)

    asyncio.run(asked())
    assert served.played.orders == []


def test_nobody_writes(served):
    async def tried():
        async with client(served, "ana") as made:
            for path in ("Monitoring/State", "Monitoring/Connected"):
                with pytest.raises(ua.UaStatusCodeError):
                    await (await node(made, path)).write_value("TRACKING")
            with pytest.raises(ua.UaStatusCodeError):
                await (await node(made, "Monitoring/State")).write_attribute(
                    ua.AttributeIds.DisplayName, ua.DataValue(ua.Variant(ua.LocalizedText("OFF")))
                )
            with pytest.raises(ua.UaStatusCodeError):
                await made.nodes.objects.add_object(ua.NodeId("mine", 1), "1:mine")

    asyncio.run(tried())


@pytest.mark.parametrize("channel", ["ana", "eve"])
def test_a_certificate_of_another_s_is_of_no_use_without_his_key(served, channel):
    _, private = certificate(served.people, "eve")
    served.played.orders.clear()

    async def asked():
        async with client(served, channel, key=private, as_user=served.people / "ana.pem", patience_s=1.0) as made:
            await call(made, "Arm")

    with pytest.raises(DENIED):
        asyncio.run(asked())
    assert served.played.orders == []


def test_a_certificate_that_has_expired_counts_no_more(served):
    public, _ = certificate(served.people, "old", days=(-30, -1))
    (served.folder / "operate" / "old.pem").write_bytes(public.read_bytes())
    served.played.orders.clear()

    async def asked():
        async with client(served, "old") as made:
            await call(made, "Arm")

    with pytest.raises(DENIED):
        asyncio.run(asked())
    assert served.played.orders == []
    assert "OPC UA: old was sent away: the certificate is valid from " in served.lines[0]


@pytest.mark.parametrize(
    ("policy", "mode"),
    [(Basic256Sha256, ua.MessageSecurityMode.SignAndEncrypt), (Encrypted, ua.MessageSecurityMode.Sign)],
)
def test_another_security_policy_is_refused_at_once_and_by_its_name(served, policy, mode):
    async def asked():
        made = Client(served.server.url, timeout=30.0)
        made.application_uri = "urn:test:client"
        public, private = served.people / "ana.pem", served.people / "ana-key.pem"
        await made.set_security(policy, public, private, None, served.folder / "server.pem", mode)
        async with made:
            pass

    with pytest.raises((ua.UaError, ConnectionError), match="BadSecurityPolicyRejected"):
        asyncio.run(asked())


def test_from_elsewhere_only_those_who_are_known_come_in(remote):
    certificate(remote.people, "eve")

    async def came(name):
        async with client(remote, name) as made:
            return await value(made, "Monitoring/Connected")

    assert asyncio.run(came("ben")) is False
    for name in (None, "eve"):
        with pytest.raises(DENIED):
            asyncio.run(came(name))


def test_faults_states_and_refusals_are_events(served):
    heard = []

    class Handler:
        def event_notification(self, event):
            heard.append(event)

    async def followed():
        served.say(status("READY"))
        async with client(served, "ana") as made:
            await eventually(lambda: value(made, "Monitoring/State"), "READY")
            index = await made.get_namespace_index(NAMESPACE)
            kinds = [
                await made.nodes.base_event_type.get_child(f"{index}:{kind}EventType")
                for kind in ("Fault", "State", "Refused")
            ]
            subscription = await made.create_subscription(20, Handler())
            await subscription.subscribe_events(made.get_node(ua.NodeId("cell", index)), kinds)
            served.say(status("FAULT", [FAULT]))
            served.played.refuses = "arm refused: the state is FAULT"
            with pytest.raises(ua.UaStatusCodeError, match="BadInvalidState"):
                await call(made, "Arm")
            served.played.refuses = None
            for _ in range(3000):
                if len(heard) >= 3:
                    break
                await asyncio.sleep(0.02)

    asyncio.run(followed())
    by_message = {event.Message.Text: event for event in heard}
    assert by_message.keys() == {FAULT["seen"], "READY -> FAULT", "arm refused: the state is FAULT"}
    fault = by_message[FAULT["seen"]]
    assert (fault.Code, fault.Axis, fault.Value, fault.NextStep) == ("X-201", "x", 3.0, FAULT["next_step"])
    assert math.isnan(fault.Limit)
    assert fault.Severity == 900
    assert by_message["arm refused: the state is FAULT"].Person == "ana"


def test_the_server_s_key_is_its_owner_s_alone(tmp_path):
    public, private, is_new, *_ = prepared_folder(tmp_path / "opcua")
    assert is_new
    assert private.stat().st_mode & 0o777 == 0o600
    before = public.read_bytes()
    assert prepared_folder(tmp_path / "opcua").is_new is False
    assert public.read_bytes() == before
    private.chmod(0o644)
    with pytest.raises(PermissionDenied, match=r"server\.key: others may read this key"):
        prepared_folder(tmp_path / "opcua")


def test_a_folder_that_others_may_fill_and_an_old_certificate_are_refused(tmp_path):
    prepared_folder(tmp_path)
    (tmp_path / "operate").chmod(0o777)
    with pytest.raises(PermissionDenied, match="others may put certificates there"):
        prepared_folder(tmp_path)
    (tmp_path / "operate").chmod(0o700)
    public, private = certificate(tmp_path.parent, "server", days=(-20, -10))
    (tmp_path / "server.pem").write_bytes(public.read_bytes())
    (tmp_path / "server.key").write_bytes(private.read_bytes())
    with pytest.raises(ConfigError, match="expired on"):
        prepared_folder(tmp_path)
