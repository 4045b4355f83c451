"""Certificates that browsers and clients would not believe: told at the start, with what is wrong."""

import asyncio

import pytest

pytest.importorskip("cryptography")
pytest.importorskip("uvicorn", reason="the extra gateway is not installed")

from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec

from micromanip.errors import ConfigError, PermissionDenied
from micromanip.gateway import serving
from micromanip.gateway.certificates import checked
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
