"""Tokens: made at the first start, for their owner only; a wrong file is told by its line."""

import stat

import pytest

from micromanip.cli import gateway as command
from micromanip.errors import ConfigError, DeviceUnavailable, PermissionDenied, UsageError
from micromanip.gateway.serving import Options, serve
from micromanip.gateway.tokens import load_tokens
from tests.cli.command import code_of

GOOD = "screen observe " + "s" * 24


def test_the_first_start_makes_one_of_each_scope(tmp_path):
    path = tmp_path / "state" / "tokens"
    tokens, is_new = load_tokens(path)
    assert is_new
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    again, is_new = load_tokens(path)
    assert not is_new
    secrets = [line.split() for line in path.read_text().splitlines() if not line.startswith("#")]
    assert [(name, scope) for name, scope, _ in secrets] == [("screen", "observe"), ("operator", "operate")]
    assert again.find(secrets[1][2]).operates
    assert not tokens.find(secrets[0][2]).operates
    assert tokens.find(secrets[0][2][:-1]) is None
    assert tokens.find("") is None


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o660])
def test_a_file_that_others_read_is_refused(tmp_path, mode):
    path = tmp_path / "tokens"
    path.write_text(GOOD)
    path.chmod(mode)
    with pytest.raises(PermissionDenied, match="others may read these tokens"):
        load_tokens(path)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("screen observe", "tokens:1: expected `name scope token`"),
        (f"# mine\n\n{GOOD} x", "tokens:3: expected"),
        ("screen watch " + "s" * 24, "tokens:1: screen: a scope is observe or operate, not 'watch'"),
        ("screen observe short", "at least 20"),
        (f"{GOOD}\nother operate " + "s" * 24, "tokens:2: other: this name or token is there already"),
        ("a/b observe " + "s" * 24, "a name has"),
        ("# nobody\n", "there is no token in it"),
    ],
)
def test_a_wrong_line_is_told(tmp_path, text, said):
    path = tmp_path / "tokens"
    path.write_text(text)
    path.chmod(0o600)
    with pytest.raises(ConfigError, match=said):
        load_tokens(path)


@pytest.mark.parametrize(
    ("given", "error", "said"),
    [
        ({"listen": "0.0.0.0:8443"}, UsageError, "whoever can read along"),
        ({"listen": "cell.example:8443"}, UsageError, "whoever can read along"),
        ({"listen": "127.0.0.1"}, UsageError, "expected HOST:PORT"),
        ({"listen": "127.0.0.1:99999"}, UsageError, "expected HOST:PORT"),
        ({"behind_proxy": "cell.example"}, UsageError, "such as https://cell.example"),
        ({"certificate": "cell.pem"}, UsageError, "go together"),
        ({"certificate": "cell.yaml", "key": "cell.yaml"}, ConfigError, "not a certificate in PEM"),
        ({"certificate": "none.pem", "key": "cell.yaml"}, UsageError, r"none\.pem: No such file"),
        ({"config": "nowhere.yaml"}, UsageError, r"nowhere\.yaml: No such file"),
        ({"listen": "192.0.2.1:8090", "behind_proxy": "https://cell.example"}, DeviceUnavailable, "choose another"),
    ],
)
def test_what_can_t_be_served_is_told_at_once(tmp_path, given, error, said):
    (tmp_path / "cell.yaml").write_text("schema_version: 2\n")
    paths = {name: tmp_path / value for name, value in given.items() if name in ("certificate", "key", "config")}
    plain = {"config": tmp_path / "cell.yaml", "control": tmp_path / "no.sock", "listen": "127.0.0.1:0"}
    with pytest.raises(error, match=said):
        serve(Options(**(plain | {"tokens": tmp_path / "tokens"} | given | paths)), print)


@pytest.mark.parametrize(
    ("loop", "cpu"),
    [("loop: {cpu: 3, limits: hardware}", 3), ("loop: {limits: hardware}", None), ("loop: {cpu: x}", None)],
)
def test_it_leaves_the_loop_s_cpu_to_the_loop(tmp_path, monkeypatch, loop, cpu):
    left = []
    monkeypatch.setattr("os.umask", lambda _: 0)  # it would be that of the tests after this one, too
    monkeypatch.setattr(command, "leave_cpu", left.append)
    (tmp_path / "cell.yaml").write_text(f"schema_version: 2\n{loop}\n")
    elsewhere = ("--listen", "192.0.2.1:8090", "--behind-proxy", "https://cell.example")
    assert code_of("gateway", tmp_path / "cell.yaml", "--tokens", tmp_path / "tokens", *elsewhere) == 69
    assert left == [cpu]
