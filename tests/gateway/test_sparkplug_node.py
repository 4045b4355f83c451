"""What an edge node says, read by a decoder of its own: a few lines by the specification, and pysparkplug."""

import struct

import pytest

pytest.importorskip("google.protobuf", reason="the extra sparkplug is not installed")

from hypothesis import given
from hypothesis import strategies as st

from micromanip.gateway.readings import Reading
from micromanip.gateway.sparkplug.commands import PrimaryHost, command
from micromanip.gateway.sparkplug.node import EdgeNode
from micromanip.gateway.sparkplug.options import Options
from micromanip.gateway.sparkplug.schema import Payload
from micromanip.gateway.telling import Teller

OPTIONS = Options(host="127.0.0.1", group="plant", node="cell7", deadbands={"um": 0.5, "V": 0.1})
NOW = 1_800_000_000_000


def fields(content):
    """Fields of a protobuf message by number, in order; wire types of https://protobuf.dev/programming-guides/encoding."""
    found = []

    def number():
        nonlocal content
        value = shift = 0
        while True:
            byte, content = content[0], content[1:]
            value |= (byte & 127) << shift
            shift += 7
            if byte < 128:
                return value

    while content:
        key = number()
        if key & 7 == 0:
            found.append((key >> 3, number()))
        elif key & 7 == 1:
            found.append((key >> 3, struct.unpack("<d", content[:8])[0]))
            content = content[8:]
        else:
            size = number()
            found.append((key >> 3, content[:size]))
            content = content[size:]
    return found


def only(found, number):
    return next((value for key, value in found if key == number), None)


def metrics(message):
    """Of a message: (name, alias, datatype, value) of each metric, None where it does not say."""
    read = [fields(value) for key, value in fields(message.payload) if key == 2]
    values = [next((m_value for key, m_value in metric if 10 <= key <= 15), None) for metric in read]
    return [
        (name and name.decode(), only(metric, 2), only(metric, 4), value)
        for metric, value in zip(read, values, strict=True)
        for name in [only(metric, 1)]
    ]


def seq(message):
    return only(fields(message.payload), 3)


def axis(name, position, voltage=80.0):
    at = ("Monitoring", "Axes", name)
    return [Reading((*at, "Position"), float, position, "um"), Reading((*at, "Voltage"), float, voltage, "V")]


def said(state="READY", cycles=0, faults=(), axes=()):
    return [
        Reading(("Monitoring", "State"), str, state),
        Reading(("Monitoring", "Timing", "Cycles"), int, cycles),
        Reading(("Notification", "Faults"), list, list(faults)),
        *(reading for each in axes for reading in each),
    ]


def kinds(messages):
    return ["/".join([part for part in m.topic.split("/")[2:] if part != "cell7"]) for m in messages]


def test_a_birth_names_everything_with_type_alias_and_unit():
    node = EdgeNode(OPTIONS, 7)
    messages = list(node.birth(said(cycles=-1, axes=[axis("x", 51.25), axis("y", None)]), NOW))
    assert [m.topic for m in messages] == [
        "spBv1.0/plant/NBIRTH/cell7", "spBv1.0/plant/DBIRTH/cell7/x", "spBv1.0/plant/DBIRTH/cell7/y"
    ]  # fmt: skip
    assert [seq(m) for m in messages] == [0, 1, 2]
    of_node, of_x, of_y = map(metrics, messages)
    assert of_node[:2] == [("bdSeq", None, 4, 7), ("Node Control/Rebirth", None, 11, 0)]
    assert of_node[2:] == [
        ("Monitoring/State", 1, 12, b"READY"), ("Monitoring/Timing/Cycles", 2, 4, 2**64 - 1),
        ("Notification/Faults", 3, 12, b""),
    ]  # fmt: skip
    assert of_x == [("Position", 4, 10, 51.25), ("Voltage", 5, 10, 80.0)]
    assert of_y == [("Position", 6, 10, None), ("Voltage", 7, 10, 80.0)]
    position = fields(next(value for key, value in fields(messages[1].payload) if key == 2))
    assert fields(only(position, 9))[0] == (1, b"engUnit")
    assert only(fields(only(fields(only(position, 9)), 2)), 8) == b"um"


def test_only_what_has_left_its_deadband_is_sent_by_its_alias_and_with_its_type():
    """sparkplug-payload 1.0.3, the common decoder for JavaScript, reads null where data has no type."""
    node = EdgeNode(OPTIONS, 0)
    list(node.birth(said(axes=[axis("x", 10.0)]), NOW))
    assert list(node.changes(said(axes=[axis("x", 10.4, 80.09)]), NOW)) == []
    (data,) = node.changes(said(axes=[axis("x", 10.5, 80.09)]), NOW)
    assert kinds([data]) == ["DDATA/x"]
    assert metrics(data) == [(None, 4, 10, 10.5)]
    (data,) = node.changes(said(axes=[axis("x", 10.1, 80.11)]), NOW)  # against what was sent last, each
    assert metrics(data) == [(None, 5, 10, 80.11)]
    (data,) = node.changes(said(axes=[axis("x", None, float("nan"))]), NOW)
    assert metrics(data) == [(None, 4, 10, None), (None, 5, 10, None)]
    assert [only(fields(value), 7) for key, value in fields(data.payload) if key == 2] == [1, 1], "is_null"
    (data,) = node.changes(said("FAULT", 5, ["a", "b"], [axis("x", None, None)]), NOW)
    assert metrics(data) == [(None, 1, 12, b"FAULT"), (None, 2, 4, 5), (None, 3, 12, b"a\nb")]


@given(st.lists(st.floats(-1e3, 1e3), max_size=40), st.floats(0.0, 50.0))
def test_a_host_is_never_off_by_the_deadband_and_hears_no_value_twice(values, deadband):
    node = EdgeNode(OPTIONS.model_copy(update={"deadbands": OPTIONS.deadbands.model_copy(update={"um": deadband})}), 0)
    list(node.birth(said(axes=[axis("x", 0.0)]), NOW))
    shown = 0.0
    for value in values:
        for message in node.changes(said(axes=[axis("x", value)]), NOW):
            ((_, alias, _, told),) = metrics(message)
            assert (alias, abs(told - shown) >= deadband, told != shown) == (4, True, True)
            shown = told
        assert shown == value or abs(value - shown) < deadband


def test_seq_goes_on_from_255_with_0_and_over_all_devices():
    node = EdgeNode(OPTIONS, 0)
    messages = list(node.birth(said(axes=[axis("x", 0.0), axis("y", 0.0)]), NOW))
    for k in range(1, 300):
        messages += node.changes(said(cycles=k, axes=[axis("x", k), axis("y", -k)]), NOW)
    assert [seq(m) for m in messages] == [k % 256 for k in range(len(messages))]
    assert len(messages) > 512


def test_axes_die_with_the_controller_and_are_born_again():
    node = EdgeNode(OPTIONS, 0)
    both = [axis("x", 1.0), axis("y", 2.0)]
    list(node.birth(said(axes=both), NOW))
    messages = list(node.changes([Reading(("Monitoring", "State"), str, "READY")], NOW))
    assert kinds(messages) == ["DDEATH/x", "DDEATH/y", "NDATA"]
    assert metrics(messages[0]) == []
    assert metrics(messages[2]) == [(None, 2, 4, None), (None, 3, 12, None)], "nobody knows them now"
    assert list(node.changes([Reading(("Monitoring", "State"), str, "READY")], NOW)) == []
    messages = list(node.changes(said(axes=both), NOW))
    assert sorted(kinds(messages)) == ["DBIRTH/x", "DBIRTH/y", "NDATA"]
    assert [seq(m) for m in messages] == [6, 7, 8]
    messages = list(node.changes(said(axes=[*both, axis("z", 3.0)]), NOW))
    assert kinds(messages) == ["NBIRTH", "DBIRTH/x", "DBIRTH/y", "DBIRTH/z"], "something new has to be named"
    assert [seq(m) for m in messages] == [0, 1, 2, 3]
    aliases = [alias for m in messages for _, alias, _, _ in metrics(m) if alias is not None]
    assert len(set(aliases)) == len(aliases) == 9


def test_the_will_has_the_number_of_the_births_and_no_seq():
    node = EdgeNode(OPTIONS, 255)
    will = node.death(NOW)
    assert will.topic == "spBv1.0/plant/NDEATH/cell7"
    assert metrics(will) == [("bdSeq", None, 4, 255)]
    assert seq(will) is None
    assert metrics(next(node.birth(said(), NOW)))[0] == ("bdSeq", None, 4, 255)


def test_pysparkplug_reads_the_same():
    foreign = pytest.importorskip("pysparkplug", reason="pip install --no-deps pysparkplug, as `make` does")
    node = EdgeNode(OPTIONS, 3)
    nbirth, dbirth = node.birth(said(cycles=2**40, axes=[axis("x", 51.25, None)]), NOW)
    topic = foreign.Topic.from_str(nbirth.topic)
    assert (topic.group_id, topic.message_type, topic.edge_node_id) == ("plant", foreign.MessageType.NBIRTH, "cell7")
    born = foreign.NBirth.decode(nbirth.payload)
    assert {m.name: m.value for m in born.metrics} == {
        "bdSeq": 3, "Node Control/Rebirth": False, "Monitoring/State": "READY", "Monitoring/Timing/Cycles": 2**40,
        "Notification/Faults": "",
    }  # fmt: skip
    device = foreign.DBirth.decode(dbirth.payload)
    assert [(m.name, m.datatype, m.value, m.is_null) for m in device.metrics] == [
        ("Position", foreign.DataType.DOUBLE, 51.25, False), ("Voltage", foreign.DataType.DOUBLE, None, True)
    ]  # fmt: skip
    ndata, ddata = node.changes(said("TRACKING", 2**40, axes=[axis("x", -4.5, None)]), NOW)
    told = foreign.NData.decode(ndata.payload, birth=born)
    assert (told.seq, [(m.name, m.value) for m in told.metrics]) == (2, [("Monitoring/State", "TRACKING")])
    told = foreign.DData.decode(ddata.payload, birth=device)
    assert (told.seq, [(m.name, m.value) for m in told.metrics]) == (3, [("Position", -4.5)])
    assert foreign.NDeath.decode(node.death(NOW).payload).bd_seq_metric.value == 3


def asked(*named):
    payload = Payload(timestamp=NOW)
    for name, value in named:
        payload.metrics.add(name=name, datatype=11, boolean_value=value)
    return payload.SerializeToString()


def test_of_commands_a_rebirth_alone_is_heeded():
    rebirth = ("Node Control/Rebirth", True)
    heard = command("spBv1.0/plant/NCMD/cell7", asked(rebirth))
    assert (heard.asks_rebirth, heard.ignored) == (True, None)
    heard = command("spBv1.0/plant/NCMD/cell7", asked(("Node Control/Rebirth", False)))
    assert (heard.asks_rebirth, heard.ignored) == (False, None)
    heard = command("spBv1.0/plant/NCMD/cell7", asked(rebirth, ("arm", True)))
    assert (heard.asks_rebirth, heard.ignored) == (True, "NCMD of arm")
    heard = command("spBv1.0/plant/DCMD/cell7/x", asked(rebirth, ("a\nb", True), ("c", True), ("d", True)))
    assert not heard.asks_rebirth
    assert heard.ignored == "DCMD of Node Control/Rebirth, a\\nb, c and 1 more"


@given(st.binary(max_size=60))
def test_no_bytes_make_a_command_fail(content):
    heard = command("spBv1.0/plant/NCMD/cell7", content)
    assert heard.asks_rebirth is False or b"Node Control/Rebirth" in content


def test_the_primary_host_is_online_by_its_newest_word():
    host = PrimaryHost("scada")
    assert (host.topic, host.is_online) == ("spBv1.0/STATE/scada", False)
    for content, is_online in (
        (b'{"online": true, "timestamp": 5}', True),
        (b'{"online": false, "timestamp": 4}', True),
        (b"OFFLINE", True),
        (b'{"online": 0, "timestamp": 9}', True),
        (b"[1]", True),
        (b'{"online": false, "timestamp": 5}', False),
    ):
        host.hear(content)
        assert host.is_online is is_online, content


def test_events_are_told_once_a_minute_and_states_when_they_change():
    lines, now = [], [0.0]
    teller = Teller(lines.append, lambda: now[0])
    for _ in range(3):
        teller.event("ignored a")
        teller.state("connected")
    now[0] = 60.0
    teller.event("ignored b")
    assert lines == ["ignored a", "connected", "ignored b (2 more since the last line)"]
