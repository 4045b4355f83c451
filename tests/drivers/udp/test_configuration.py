"""What `check` says of a cell on the driver `udp`: what it carries, and what can't be right."""

import json

import pytest

from campaigns.report import CONFIG
from micromanip.cli.main import main
from micromanip.errors import ConfigError
from micromanip.settings.check import prepare

UDP = CONFIG / "udp.yaml"


def changed(folder, *changes):
    text = UDP.read_text(encoding="utf-8")
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new, 1)
    file = folder / "cell.yaml"
    file.write_text(text, encoding="utf-8")
    return file


def test_check_tells_what_the_wire_carries(capsys):
    main(["check", str(UDP), "--json"])
    report = json.loads(capsys.readouterr().out)
    out, back = report["buses"]["cell"]
    assert (out["name"], back["name"]) == ("out", "in")
    assert out["share_percent"] == pytest.approx(100 * 10_000 * 8 * (23 + 66) / 100e6, abs=0.1)
    assert back["share_percent"] == pytest.approx(100 * 10_000 * 8 * (61 + 66) / 100e6, abs=0.1)
    assert report["drivers"]["cell"]["watchdog"].startswith("at rest 250 ms after 100 ms")


def test_a_wire_that_is_too_slow_is_refused(tmp_path):
    slow = changed(tmp_path, ("    port: 4840\n", "    port: 4840\n    link_Mbit_per_s: 10\n"))
    with pytest.raises(ConfigError, match=r"in would be busy for 102 % of the time"):
        prepare(slow)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ([("park_V: 0}", "park_V: 5}")], r"outputs\.voltage_x\.park_V: 5 V, but driver cell brings this channel to 0"),
        ([("    silence_ms: 50 ", "    silence_ms: 51 ")], "must be at most half of the watchdog's 100 ms"),
        ([("    host: 127.0.0.1 ", "    host: 192.0.2.1 ")], "192.0.2.1 is not this machine"),
        ([("cyclic_safe: true", "cyclic_safe: false")], "10000 writes per second wear out a device"),
        (
            [("      acknowledges: {at: 55, type: uint16, byte_order: little}", "")],
            "receive.acknowledges must be given",
        ),
        ([("acknowledges: {at: 55, type: uint16", "acknowledges: {at: 55, type: uint32")], "both must be as long"),
    ],
)
def test_what_can_not_be_right_is_refused(tmp_path, changes, said):
    with pytest.raises(ConfigError, match=said):
        prepare(changed(tmp_path, *changes))


def test_outputs_need_a_watchdog(tmp_path):
    text = UDP.read_text(encoding="utf-8")
    first, last = text.index("    watchdog:"), text.index("    crc:")
    file = tmp_path / "cell.yaml"
    file.write_text(text[:first] + text[last:], encoding="utf-8")
    with pytest.raises(ConfigError, match="watchdog must be given"):
        prepare(file)
