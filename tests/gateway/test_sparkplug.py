"""The edge node on a real socket: with a small broker that can be spoilt, and with mosquitto where there is one."""

import json
from itertools import pairwise

import pytest

pytest.importorskip("paho", reason="the extra sparkplug is not installed")

from campaigns.running_controller import until
from micromanip.cli.main import main
from micromanip.errors import ConfigError, PermissionDenied
from micromanip.gateway.cell import Cell
from micromanip.gateway.sparkplug.options import Options, Tls
from micromanip.gateway.sparkplug.schema import Payload
from micromanip.gateway.sparkplug.service import Sparkplug

from .beside import Beside, free_port
from .certificates import LOCAL, certificate
from .mqtt import MOSQUITTO, Host, Mosquitto, SmallBroker
from .rings import status

pytestmark = pytest.mark.live
OPTIONS = Options(host="127.0.0.1", port=1883, group="plant", node="cell7", period_s=0.25)


class Published(Beside):
    """An edge node before a cell whose status the test says; `lines` is what it said itself."""

    def __init__(self, folder, port, **options):
        self.lines = []
        told = Options.model_validate(OPTIONS.model_dump() | {"port": port} | options)
        cell = Cell(folder / "control.sock")
        super().__init__(cell, Sparkplug(cell, told, self.lines.append))

    def said(self, part, times=1):
        until(lambda: sum(part in line for line in self.lines) >= times, lambda: f"{part}: {self.lines}")


@pytest.fixture(params=["small", "mosquitto"])
def broker(request, tmp_path):
    if request.param == "mosquitto" and MOSQUITTO is None:
        pytest.skip("mosquitto is not installed: apt-get install mosquitto")
    made = SmallBroker() if request.param == "small" else Mosquitto(tmp_path)
    yield made
    made.close()


def read(content):
    return Payload.FromString(content)


def values(content):
    return {m.name: getattr(m, m.WhichOneof("value") or "", None) for m in read(content).metrics}


def rebirth(value=True, name="Node Control/Rebirth"):
    payload = Payload(timestamp=1)
    payload.metrics.add(name=name, datatype=11, boolean_value=value)
    return payload.SerializeToString()


def test_a_host_follows_births_data_rebirths_and_deaths(tmp_path, broker, closing):
    host = Host(broker.port)
    closing.append(host)
    node = Published(tmp_path, broker.port)
    node.say(status())
    until(lambda: len(host.heard("DBIRTH")) >= 2, "two axes are born")
    born = values(host.heard("NBIRTH")[-1])
    assert born["Node Control/Rebirth"] is False
    assert born["Monitoring/State"] == "TRACKING"
    assert values(host.heard("DBIRTH")[-1])["Voltage"] == 100.0
    number = born["bdSeq"]

    node.say(status("HOLDING"))
    until(lambda: any("HOLDING" in str(read(c)) for c in host.heard("NDATA")), "a change is told")
    before = len(host.heard("NBIRTH"))
    host.say("spBv1.0/plant/NCMD/cell7", rebirth())
    until(lambda: len(host.heard("NBIRTH")) > before, "it is born again")
    again = host.heard("NBIRTH")[-1]
    assert (values(again)["bdSeq"], read(again).seq) == (number, 0)
    assert values(again)["Monitoring/State"] == "HOLDING"

    node.say(None)
    until(lambda: len(host.heard("DDEATH")) == 2, "the axes go with the controller")
    node.close()
    until(lambda: host.heard("NDEATH"), "it says when it leaves")
    assert values(host.heard("NDEATH")[0]) == {"bdSeq": number}
    order = [read(content).seq for topic, content in host.messages if topic.split("/")[2] in
             ("NBIRTH", "NDATA", "DBIRTH", "DDATA", "DDEATH")]  # fmt: skip
    assert all(later in (0, (earlier + 1) % 256) for earlier, later in pairwise(order)), order


def test_orders_by_mqtt_are_ignored_and_noted(tmp_path, broker, closing):
    host = Host(broker.port)
    closing.append(host)
    node = Published(tmp_path, broker.port)
    closing.append(node)
    node.say(status())
    until(lambda: len(host.heard("DBIRTH")) >= 2, "two axes are born")
    births = len(host.heard("NBIRTH"))
    orders = []
    node.cell.order = lambda *asked, **_: orders.append(asked)
    host.say("spBv1.0/plant/DCMD/cell7/x", rebirth(name="arm"))
    node.said("ignored DCMD of arm: nothing is written by MQTT")
    assert (orders, len(host.heard("NBIRTH"))) == ([], births)
    node.say(status("HOLDING"))
    until(lambda: any("HOLDING" in str(read(c)) for c in host.heard("NDATA")), "and it goes on")


def test_a_broker_that_comes_late_and_dies_is_told_of_once_and_found_again(tmp_path, closing):
    port = free_port()
    node = Published(tmp_path, port)
    closing.append(node)
    node.say(status())
    node.said("Connection refused; it is tried again")
    broker = SmallBroker(port)
    closing.append(broker)
    node.said(f"cell7 at 127.0.0.1:{port}: connected")
    broker.close()
    node.said("it is tried again", 2)
    broker = SmallBroker(port)
    closing.append(broker)
    host = Host(port)
    closing.append(host)
    until(lambda: host.heard("NBIRTH"), "it is born to the new one", 20.0)
    node.said("connected", 2)
    assert len(node.lines) == 4, node.lines


def test_the_broker_says_the_will_of_a_node_that_is_cut_off(tmp_path, closing):
    broker = SmallBroker()
    closing.append(broker)
    host = Host(broker.port)
    closing.append(host)
    node = Published(tmp_path, broker.port)
    closing.append(node)
    until(lambda: host.heard("NBIRTH"), "born")
    number = values(host.heard("NBIRTH")[-1])["bdSeq"]
    broker.cut_off_others(host)
    until(lambda: host.heard("NDEATH"), "the will is published")
    assert values(host.heard("NDEATH")[0])["bdSeq"] == number
    until(
        lambda: values(host.heard("NBIRTH")[-1])["bdSeq"] == number + 1,
        lambda: f"the next session has the next number: {node.lines} {broker.attempts}",
    )


@pytest.mark.skipif(MOSQUITTO is None, reason="mosquitto is not installed: apt-get install mosquitto")
def test_a_session_that_was_left_at_the_broker_dies_before_the_next_is_born(tmp_path, closing):
    """Else its will would come later, with the number of the new birth: the host would take the new one for dead."""
    broker = Mosquitto(tmp_path)
    closing.append(broker)
    host = Host(broker.port)
    closing.append(host)
    for _ in range(2):
        node = Published(tmp_path, broker.port)
        closing.append(node)
        births = len(host.heard("NBIRTH"))
        until(lambda: len(host.heard("NBIRTH")) > births, "born")  # noqa: B023
    order = [kind for topic, _ in list(host.messages) if (kind := topic.split("/")[2]) in ("NBIRTH", "NDEATH")]
    assert order[:3] == ["NBIRTH", "NDEATH", "NBIRTH"]


def test_nothing_is_published_without_the_primary_host(tmp_path, broker, closing):
    host = Host(broker.port)
    closing.append(host)
    node = Published(tmp_path, broker.port, primary_host="scada")
    closing.append(node)
    node.say(status())
    node.said("waits for the primary host scada")
    assert not host.heard("NBIRTH")
    state = "spBv1.0/STATE/scada"
    host.say(state, json.dumps({"online": True, "timestamp": 2}), retain=True)
    until(lambda: host.heard("NBIRTH"), "born")
    host.say(state, json.dumps({"online": False, "timestamp": 1}), retain=True)
    host.say(state, json.dumps({"online": False, "timestamp": 3}), retain=True)
    until(lambda: host.heard("NDEATH"), "it leaves with its host")
    node.said("waits for the primary host scada", 2)
    births = len(host.heard("NBIRTH"))
    host.say(state, json.dumps({"online": True, "timestamp": 4}), retain=True)
    until(lambda: len(host.heard("NBIRTH")) > births, "born again")


def test_a_wrong_password_is_told_once_and_the_right_one_lets_in(tmp_path, closing):
    broker = SmallBroker(login=("cell", "right"))
    closing.append(broker)
    secret = tmp_path / "password"
    secret.touch(0o600)
    for password, part in (("wrong", "Not authorized; it is tried again"), ("right", "connected")):
        secret.write_text(password + "\n")
        node = Published(tmp_path, broker.port, user="cell", password_file=secret)
        closing.append(node)
        before = broker.attempts
        node.said(part)
        until(lambda: broker.attempts - before >= (2 if password == "wrong" else 1), "it is tried again")  # noqa: B023
        assert len(node.lines) == 1
        assert password not in node.lines[0]


@pytest.mark.parametrize(
    ("days", "names", "part"),
    [
        ((-2, 20), LOCAL, "connected"),
        ((-2, -1), LOCAL, "its certificate: certificate has expired; it is tried again"),
        ((-2, 20), (), "its certificate: IP address mismatch"),
    ],
)
def test_the_broker_has_to_show_a_certificate_that_holds(tmp_path, closing, days, names, part):
    public, private = certificate(tmp_path, "broker", days, names=names)
    broker = SmallBroker(tls=(public, private))
    closing.append(broker)
    node = Published(tmp_path, broker.port, tls=Tls(ca=public))
    closing.append(node)
    node.said(part)
    assert len(node.lines) == 1


def test_a_port_for_tls_is_guessed_at_where_none_was_told(tmp_path, closing):
    broker = SmallBroker(tls=certificate(tmp_path, "broker", names=LOCAL))
    closing.append(broker)
    node = Published(tmp_path, broker.port)
    closing.append(node)
    node.said("it ended the connection without an answer: is it a port for TLS?")


def test_a_broker_that_never_answers_holds_nothing_up(tmp_path, closing):
    broker = SmallBroker(is_deaf=True)
    closing.append(broker)
    node = Published(tmp_path, broker.port)
    until(lambda: broker.attempts, "it connects")
    node.say(status())
    node.close()
    assert node.lines == []


GOOD = "host: broker.example\ngroup: plant\nnode: cell7\n"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("- a\n", "mqtt.yaml:1: "),
        (GOOD + "hots: 5\n", "mqtt.yaml:4: hots: "),
        (GOOD.replace("cell7", "a/b"), "mqtt.yaml:3: node: "),
        (GOOD + "port: 70000\n", "mqtt.yaml:4: port: "),
        (GOOD + "deadbands:\n  um: -1\n", "mqtt.yaml:5: deadbands.um: "),
        (GOOD + "user: a\npassword_file: b\n", "tls missing: the password would cross the network"),
        (GOOD + "tls: {}\npassword_file: b\n", "user missing"),
        (GOOD + "tls: {certificate: a.pem}\n", "certificate and key go together"),
        (GOOD + "tls: {ca: mqtt.yaml}\n", "mqtt.yaml: no certificates in PEM"),
    ],
)
def test_a_wrong_file_is_told_by_its_line_and_key(tmp_path, capsys, monkeypatch, text, said):
    monkeypatch.setattr("os.umask", lambda _: 0)  # it would be that of the tests after this one, too
    file = tmp_path / "mqtt.yaml"
    file.write_text(text)
    config, tokens = tmp_path / "cell.yaml", tmp_path / "tokens"
    config.write_text("")
    with pytest.raises(SystemExit) as ended:
        main(["gateway", str(config), "--tokens", str(tokens), "--sparkplug", str(file)])
    assert ended.value.code == 78
    assert said in capsys.readouterr().err


def test_a_password_is_kept_from_others_and_is_one_line(tmp_path):
    file = tmp_path / "password"
    file.write_text("secret\n")
    file.chmod(0o644)
    options = Options(host="localhost", group="g", node="n", user="u", password_file="password").beside(tmp_path)
    with pytest.raises(PermissionDenied, match="others may read this password"):
        options.password()
    file.chmod(0o600)
    assert options.password() == "secret"
    file.write_text("\n\n")
    with pytest.raises(ConfigError, match="expected the password of the broker in one line, found 2 lines"):
        options.password()
