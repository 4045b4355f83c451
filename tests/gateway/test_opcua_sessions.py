"""Whose session and whose subscription it is: another client's is of no use, and what is gone is told to be gone."""

import asyncio
import contextlib
import threading

import pytest

pytest.importorskip("asyncua")

from asyncua import Client, ua
from asyncua.server.binary_server_asyncio import OPCUAProtocol
from asyncua.ua.ua_binary import struct_from_binary

from .rings import status
from .test_opcua import Served, client, eventually, node, value

pytestmark = pytest.mark.live  # a server, and clients with time-outs


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    made = Served(tmp_path_factory.mktemp("sessions"), is_local=True)
    yield made
    made.close()


class Heard:
    def datachange_notification(self, node, value, data):
        pass


@contextlib.asynccontextmanager
async def channel(served, token):
    """A stranger's, who says this token of a session."""
    made = Client(served.server.url, timeout=60.0)
    await made.connect_socket()
    try:
        await made.send_hello()
        await made.open_secure_channel()
        made.uaclient.session.restore_authentication_token(token)
        yield made
    finally:
        made.disconnect_socket()


async def answered(made, request, response):
    return struct_from_binary(response, await made.uaclient.protocol.send_request(request))


def no_proof():
    """What no server takes for somebody's, and what anybody may say."""
    for token in (ua.UserNameIdentityToken(UserName="ana", Password=b"", PolicyId="0"), ua.AnonymousIdentityToken("0")):
        params = ua.ActivateSessionParameters()
        params.UserIdentityToken = token
        yield params


@pytest.mark.parametrize("knows", [True, False])
def test_nobody_gives_orders_in_another_s_session(served, knows):
    served.played.orders.clear()
    order = ua.CallRequest()
    order.Parameters.MethodsToCall = [ua.CallMethodRequest(ua.NodeId("cell", 2), ua.NodeId("cell/Arm", 2), [])]

    async def asked():
        async with client(served, "ana") as operator:
            token = operator.uaclient.session.authentication_token
            guessed = [token] if knows else [ua.NodeId(number) for number in range(1000, 1100)]
            for params in no_proof() if knows else [next(no_proof())]:
                for tried in guessed:
                    async with channel(served, tried) as stranger:
                        with pytest.raises(ua.UaStatusCodeError):
                            await stranger.uaclient.activate_session(params)
                        with pytest.raises(ua.UaStatusCodeError):
                            await answered(stranger, order, ua.CallResponse)
            assert served.played.orders == []
            await answered(operator, order, ua.CallResponse)

    asyncio.run(asked())
    assert served.played.orders == ["arm"]


def test_a_client_whose_connection_was_cut_misses_nothing(served, monkeypatch):
    cut = threading.Event()

    def lost(connection, why, real=OPCUAProtocol.connection_lost):
        real(connection, why)
        cut.set()

    async def asked():
        served.say(status())
        async with client(served) as first, client(served) as watching:
            subscription = await first.create_subscription(100, Heard())
            await subscription.subscribe_data_change(await node(first, "Monitoring/Timing/Cycles"), queuesize=50)
            await asyncio.sleep(0.3)
            token = first.uaclient.session.authentication_token
            monkeypatch.setattr(OPCUAProtocol, "connection_lost", lost)
            first.disconnect_socket()
            assert await asyncio.to_thread(cut.wait, 30.0)
            for k in range(5):
                served.say(status() | {"cycles": 1_000_000 + k})
                await eventually(lambda: value(watching, "Monitoring/Timing/Cycles"), 1_000_000 + k)
                await asyncio.sleep(0.15)  # longer than it publishes at: a dead connection would have swallowed it
            async with channel(served, token) as again:
                await again.uaclient.activate_session(list(no_proof())[1])
                told = (await answered(again, ua.PublishRequest(), ua.PublishResponse)).Parameters.NotificationMessage
                (changed,) = told.NotificationData
                seen = [item.Value.Value.Value for item in changed.MonitoredItems]
                assert [number for number in seen if number >= 1_000_000] == [1_000_000 + k for k in range(5)]
                results = await again.uaclient.delete_subscriptions([subscription.subscription_id])
                assert [result.name for result in results] == ["Good"]

    asyncio.run(asked())


def test_a_subscription_is_its_session_s_own(served):
    async def asked():
        async with client(served) as mine, client(served) as other:
            number = (await mine.create_subscription(100, Heard())).subscription_id
            assert [code.name for code in await other.uaclient.delete_subscriptions([number])] == [
                "BadSubscriptionIdInvalid"
            ]
            with pytest.raises(ua.UaStatusCodeError, match="BadSubscriptionIdInvalid"):
                await other.uaclient.create_monitored_items(ua.CreateMonitoredItemsParameters(number))
            assert [code.name for code in await mine.uaclient.delete_subscriptions([number])] == ["Good"]

    asyncio.run(asked())


def test_a_second_session_on_one_channel_is_refused_and_the_first_goes_on(served):
    async def asked():
        async with client(served) as made:
            with pytest.raises(ua.UaStatusCodeError, match="BadTooManySessions"):
                await answered(made, ua.CreateSessionRequest(), ua.CreateSessionResponse)
            assert await value(made, "Identification/Manufacturer") == "micromanip"

    asyncio.run(asked())


@pytest.mark.parametrize(
    ("asked_ms", "given_ms"), [(0.0, 50), (1e-6, 50), (float("nan"), 50), (60.0, 60), (1e300, 3.6e6)]
)
def test_nobody_has_values_published_faster_than_they_are_of_use(served, asked_ms, given_ms):
    async def asked():
        async with client(served) as made:
            params = ua.CreateSubscriptionParameters(RequestedPublishingInterval=asked_ms)
            request = ua.CreateSubscriptionRequest()
            request.Parameters = params
            return (await answered(made, request, ua.CreateSubscriptionResponse)).Parameters.RevisedPublishingInterval

    assert asyncio.run(asked()) == given_ms
