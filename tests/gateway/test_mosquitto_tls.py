"""TLS with a broker that was not made for it: a certificate that does not hold is one line, and nothing in plain."""

import contextlib
import socket
import threading

import pytest

pytest.importorskip("paho", reason="the extra sparkplug is not installed")

from cryptography import x509

from campaigns.running_controller import until
from micromanip.errors import ConfigError
from micromanip.gateway.sparkplug.options import Tls

from .certificates import LOCAL, authority, certificate
from .mqtt import MOSQUITTO, Mosquitto
from .test_sparkplug import Published

pytestmark = [
    pytest.mark.live,
    pytest.mark.skipif(MOSQUITTO is None, reason="mosquitto is not installed: apt-get install mosquitto"),
]
_TLS_HANDSHAKE = 0x16


class Overheard:
    """A wire to the broker; `first` are the first bytes of each connection."""

    def __init__(self, port):
        self._to, self.first = port, []
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = self._listener.getsockname()[1]
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self):
        with contextlib.suppress(OSError):
            while True:
                near = self._listener.accept()[0]
                far = socket.create_connection(("127.0.0.1", self._to))
                threading.Thread(target=self._between, args=(near, far), daemon=True).start()

    def _between(self, near, far):
        with near, far:
            back = threading.Thread(target=self._carry, args=(far, near, None), daemon=True)
            back.start()
            self._carry(near, far, self.first)
            back.join()

    def _carry(self, of, to, first):
        with contextlib.suppress(OSError):
            while data := of.recv(4096):
                if first is not None:
                    first.append(data[0])
                    first = None
                to.sendall(data)
        for end in (of, to):
            with contextlib.suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)

    def close(self):
        self._listener.close()


class Plant:
    """An authority, a broker with a certificate of it, and a wire between."""

    def __init__(self, folder, closing, days=(-2, 20), names=LOCAL, more=""):
        self.folder, self._closing = folder, closing
        self.authority = authority(folder, "authority")
        public, private = certificate(folder, "broker", days, names=names, signer=self.authority)
        self._keep(broker := Mosquitto(folder, more=f"certfile {public}\nkeyfile {private}\nuser root\n{more}"))
        self.wire = self._keep(Overheard(broker.port))

    def _keep(self, one):
        self._closing.append(one)
        return one

    def says(self, part, **tls):
        """What the node says of it, once; every byte of it was TLS."""
        node = self._keep(Published(self.folder, self.wire.port, tls=Tls(**tls)))
        node.said(part)
        until(lambda: self.wire.first, "it tries")
        assert len(node.lines) == 1, node.lines
        assert set(self.wire.first) == {_TLS_HANDSHAKE}
        return node.lines[0]


def test_a_broker_of_ones_own_authority(tmp_path, closing):
    plant = Plant(tmp_path, closing)
    plant.says("connected", ca=plant.authority[0])


def test_an_authority_that_did_not_sign_it(tmp_path, closing):
    plant = Plant(tmp_path, closing)
    other = authority(tmp_path, "other")
    said = plant.says("its certificate: ", ca=other[0])
    assert "unable to get local issuer certificate" in said
    assert "it is tried again" in said
    plant.says("its certificate: ")  # those whom the system trusts have not, either


@pytest.mark.parametrize(
    ("days", "names", "part"),
    [
        ((-20, -1), LOCAL, "its certificate: certificate has expired; it is tried again"),
        ((1, 20), LOCAL, "its certificate: certificate is not yet valid; it is tried again"),
        ((-2, 20), (x509.DNSName("broker.example"),), "its certificate: IP address mismatch"),
    ],
)
def test_a_certificate_that_does_not_hold(tmp_path, closing, days, names, part):
    plant = Plant(tmp_path, closing, days, names)
    plant.says(part, ca=plant.authority[0])


def asking(tmp_path):
    return f"cafile {tmp_path / 'authority.pem'}\nrequire_certificate true\n"


def test_a_broker_that_asks_for_our_certificate(tmp_path, closing):
    plant = Plant(tmp_path, closing, more=asking(tmp_path))
    public, private = certificate(tmp_path, "cell", signer=plant.authority)
    plant.says("connected", ca=plant.authority[0], certificate=public, key=private)


def test_a_broker_that_misses_our_certificate(tmp_path, closing):
    plant = Plant(tmp_path, closing, more=asking(tmp_path))
    said = plant.says("it is tried again", ca=plant.authority[0])
    assert "asks for a certificate of ours" in said or "does it ask for a certificate" in said, said


def test_a_broker_that_does_not_know_who_signed_ours(tmp_path, closing):
    plant = Plant(tmp_path, closing, more=asking(tmp_path))
    public, private = certificate(tmp_path, "cell", signer=authority(tmp_path, "other"))
    said = plant.says("it is tried again", ca=plant.authority[0], certificate=public, key=private)
    assert "who has signed our certificate, tls.certificate" in said or "or not take ours?" in said, said


def test_one_of_ours_that_has_expired_is_not_even_shown(tmp_path, closing):
    plant = Plant(tmp_path, closing, more=asking(tmp_path))
    public, private = certificate(tmp_path, "cell", (-20, -1), signer=plant.authority)
    with pytest.raises(ConfigError, match=r"cell\.pem expired on .*; have a new one made"):
        Published(tmp_path, plant.wire.port, tls=Tls(ca=plant.authority[0], certificate=public, key=private))
    assert plant.wire.first == []


def test_tls_at_a_port_that_speaks_none(tmp_path, closing):
    broker = Mosquitto(tmp_path)
    closing.append(broker)
    wire = Overheard(broker.port)
    closing.append(wire)
    node = Published(tmp_path, wire.port, tls=Tls())
    closing.append(node)
    node.said("it is tried again")
    assert len(node.lines) == 1
    assert "is it a port without TLS?" in node.lines[0], node.lines
    until(lambda: wire.first, "it tries")
    assert set(wire.first) == {_TLS_HANDSHAKE}
