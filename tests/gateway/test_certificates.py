"""Certificates that browsers and clients would not believe: told at the start, with what is wrong."""

import asyncio
import ipaddress
import os
import re
import time

import pytest

pytest.importorskip("cryptography")
pytest.importorskip("uvicorn", reason="the extra gateway is not installed")

from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import (
    BestAvailableEncryption,
    Encoding,
    PrivateFormat,
    load_pem_private_key,
)
from prometheus_client.parser import text_string_to_metric_families

from micromanip.errors import ConfigError, DeviceUnavailable, PermissionDenied
from micromanip.gateway import certificates, serving
from micromanip.gateway.cell import Cell
from micromanip.gateway.certificates import InUse, checked, is_for
from micromanip.gateway.metrics import Metrics
from micromanip.gateway.opcua.users import prepared_folder

from .certificates import LOCAL, certificate

KEY = ec.generate_private_key(ec.SECP256R1())


def made(folder, name="cell", days=(-1, 365), names=LOCAL):
    return certificate(folder, name, days, KEY, names)


def options(folder, public, private, listen="127.0.0.1:0", **more):
    config = folder / "cell.yaml"
    config.write_text("")
    return serving.Options(config, folder / "control.sock", listen, folder / "tokens", public, private, **more)


@pytest.fixture
def lines(monkeypatch):
    """What the gateway says that would serve then."""
    said = []

    async def begin(gateway):
        async with gateway._beside():
            said.append("serves")

    monkeypatch.setattr(serving, "run", lambda gateway, *_: asyncio.run(begin(gateway)))
    return said


@pytest.mark.parametrize(
    ("days", "said"), [((-20, -1), r"expired on \d{4}-\d\d-\d\d; "), ((1, 20), "is valid from .* set the clock")]
)
def test_a_certificate_that_is_not_valid_now_is_refused(tmp_path, lines, days, said):
    public, private = made(tmp_path, days=days)
    with pytest.raises(ConfigError, match=rf"cell\.pem {said}"):
        serving.serve(options(tmp_path, public, private), lines.append)
    with pytest.raises(ConfigError, match=rf"server\.pem {said}"):
        put_in(tmp_path / "opcua", public, private)
    assert (lines, ConfigError.exit_code) == ([], 78)


def put_in(folder, public, private):
    prepared_folder(folder)
    (folder / "server.pem").write_bytes(public.read_bytes())
    (folder / "server.key").write_bytes(private.read_bytes())
    return prepared_folder(folder)


def test_the_key_of_another_is_refused(tmp_path, lines):
    public, _ = made(tmp_path)
    _, other = certificate(tmp_path, "other", key=ec.generate_private_key(ec.SECP256R1()))
    with pytest.raises(ConfigError, match=r"other-key\.pem is not the key of .*cell\.pem"):
        serving.serve(options(tmp_path, public, other), lines.append)
    with pytest.raises(ConfigError, match=r"server\.key is not the key of .*server\.pem"):
        put_in(tmp_path / "opcua", public, other)
    assert lines == []


SM2 = """-----BEGIN CERTIFICATE-----
MIIBbjCCAROgAwIBAgIUOz5djA9BZtkSn4r284G7zU/cZyUwCgYIKoEcz1UBg3Uw
DDEKMAgGA1UEAwwBYTAeFw0yNjExMjUxNzU4MjNaFw0yNzAyMjMxNzU4MjNaMAwx
CjAIBgNVBAMMAWEwWTATBgcqhkjOPQIBBggqgRzPVQGCLQNCAASpjWV3Le+W06Mn
dTyOBKFMgV9LfaRLxYOAaq6cN/Lq3iZ7h+SiyHqJ7H0xp84QZn9QJAht/futTJ9j
6N8nCM/so1MwUTAdBgNVHQ4EFgQUNrKTEhICFAAjrS5+zjnydF6TAzswHwYDVR0j
BBgwFoAUNrKTEhICFAAjrS5+zjnydF6TAzswDwYDVR0TAQH/BAUwAwEB/zAKBggq
gRzPVQGDdQNJADBGAiEA8+n6lfIPqigH6veoeWGnnJpP205SfQhQu8AaevabgQcC
IQCJBfEeRkyFCYPgmv6ez5SfSi7A1w/e5snBHH+H/HgiVg==
-----END CERTIFICATE-----
"""
"""Of a curve that is not supported."""


def test_which_of_the_two_can_not_be_used_is_said(tmp_path):
    public, private = made(tmp_path)
    locked = tmp_path / "locked.pem"
    locked.touch(0o600)
    key = load_pem_private_key(private.read_bytes(), None)
    locked.write_bytes(key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, BestAvailableEncryption(b"secret")))
    der = tmp_path / "cell.der"
    der.write_bytes(x509.load_pem_x509_certificate(public.read_bytes()).public_bytes(Encoding.DER))
    odd = tmp_path / "sm2.pem"
    odd.write_text(SM2)
    for files, words in (
        ((private, public), r"cell-key\.pem: not a certificate in PEM"),
        ((der, private), r"cell\.der: not a certificate in PEM"),
        ((odd, private), r"sm2\.pem: not a certificate in PEM, of a kind that is known here"),
        ((public, locked), r"locked\.pem: this key has a password; write it without one"),
    ):
        with pytest.raises(ConfigError, match=words):
            checked(*files)
    public.chmod(0o600)
    with pytest.raises(ConfigError, match=r"cell\.pem: not a private key in PEM"):
        checked(public, public)


def test_a_pipe_is_not_waited_for(tmp_path):
    public, private = made(tmp_path)
    os.mkfifo(tmp_path / "pipe", 0o600)
    for files in ((tmp_path / "pipe", private), (public, tmp_path / "pipe")):
        with pytest.raises(DeviceUnavailable, match="pipe: it is not a regular file"):
            checked(*files)


@pytest.mark.parametrize(("mode", "may"), [(0o600, True), (0o640, True), (0o644, False), (0o660, False)])
def test_a_key_is_read_by_its_owner_and_its_group(tmp_path, mode, may):
    public, private = made(tmp_path)
    private.chmod(mode)
    if may:
        assert checked(public, private).not_valid_after_utc
    else:
        with pytest.raises(PermissionDenied, match=r"cell-key\.pem: others may read this key"):
            checked(public, private)


def test_one_that_expires_soon_is_warned_of_and_used(tmp_path, lines):
    public, private = made(tmp_path, days=(-1, 29))
    serving.serve(options(tmp_path, public, private), lines.append)
    assert [line for line in lines if "cell.pem expires on" in line and "in 28 days" in line] == lines[:1]
    assert lines[-1] == "serves"
    assert "server.pem expires on" in put_in(tmp_path / "opcua", public, private).warning
    public, private = made(tmp_path, days=(-1, 31))
    assert put_in(tmp_path / "opcua", public, private).warning is None


def test_one_for_another_host_is_told_with_its_names(tmp_path, lines):
    public, private = made(tmp_path, names=(x509.DNSName("cell.example"),))
    serving.serve(options(tmp_path, public, private), lines.append)
    assert f"{public} is for cell.example, not for 127.0.0.1: browsers refuse it there" in lines[0]
    lines.clear()
    serving.serve(options(tmp_path, public, private, "0.0.0.0:0"), lines.append)
    assert any(line.startswith("cell page at https://cell.example:") for line in lines), "any address: its own name"
    assert not any("refuse" in line for line in lines)
    lines.clear()
    public, private = made(tmp_path, names=())
    serving.serve(options(tmp_path, public, private), lines.append)
    assert "is for no host, not for 127.0.0.1" in lines[0]


@pytest.mark.parametrize(
    ("name", "host", "fits"),
    [
        ("cell.example", "CELL.example.", True),
        ("cell.example", "other.example", False),
        ("*.example", "cell.example", True),
        ("*.example", "a.cell.example", False),
        ("*.example", "example", False),
        ("2001:db8::1", "2001:0db8::0:1", True),
        ("10.0.0.1", "10.0.0.2", False),
    ],
)
def test_a_name_is_matched_as_browsers_do(tmp_path, name, host, fits):
    try:
        alternative = x509.IPAddress(ipaddress.ip_address(name))
    except ValueError:
        alternative = x509.DNSName(name)
    public, _ = made(tmp_path, names=(alternative,))
    assert is_for(x509.load_pem_x509_certificate(public.read_bytes()), host) is fits


def test_what_expires_while_it_is_served_is_told_again_and_in_the_metrics(tmp_path):
    said, public = [], {name: made(tmp_path, name, days)[0] for name, days in (("old", (-9, -1)), ("soon", (-9, 20)))}
    good = made(tmp_path, "good")[0]
    used = InUse(said.append)
    for file in (*public.values(), good):
        used.add(file, x509.load_pem_x509_certificate(file.read_bytes()))
    used.look()
    assert [re.sub(r"\d{4}-\d\d-\d\d", "DAY", line).partition(";")[0] for line in said] == [
        f"WARNING: {public['old']} expired on DAY",
        f"WARNING: {public['soon']} expires on DAY, in 19 days",
    ]
    text = Metrics(Cell(tmp_path / "control.sock"), int, int, used.expiries).text().decode()
    (family,) = [each for each in text_string_to_metric_families(text) if "certificate" in each.name]
    found = {sample.labels["certificate"]: sample.value for sample in family.samples}
    assert set(found) == {str(each) for each in (*public.values(), good)}
    assert found[str(public["soon"])] == pytest.approx(time.time() + 20 * 86_400, abs=600)


def test_it_is_looked_at_again_without_a_new_start(tmp_path, monkeypatch):
    monkeypatch.setattr(certificates, "_AGAIN_S", 0.0)

    async def watched():
        said = asyncio.Queue()
        used = InUse(said.put_nowait)
        file = made(tmp_path, days=(-9, -1))[0]
        used.add(file, x509.load_pem_x509_certificate(file.read_bytes()))
        following = asyncio.create_task(used.follow())
        lines = [await asyncio.wait_for(said.get(), 10.0) for _ in range(2)]
        following.cancel()
        return lines

    assert all("expired on" in line for line in asyncio.run(watched()))
