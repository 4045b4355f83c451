"""The pages in a real browser, before a made-up ring: nothing from elsewhere, no complaint, exact triggers."""

import asyncio
import time

import numpy as np
import pytest

from campaigns.running_controller import until
from micromanip.errors import CheckFailed
from micromanip.gateway.app import Gateway
from micromanip.gateway.guard import Origins
from micromanip.gateway.tokens import Token, Tokens
from micromanip.gateway.viewing import AnonymousTokens, RecordedCell
from micromanip.rt import states
from tests.cli.played import FAULT
from tests.gateway.chromium import PROGRAM, chromium

from .rings import Played, rows, status
from .served import follow, served
from .test_recording_history import FAULT_CYCLE, written
from .test_recording_history import opened as filed

pytestmark = [pytest.mark.live, pytest.mark.skipif(PROGRAM is None, reason="chromium is not installed")]
DO = "d" * 24
MIXED = """(() => {
    const canvas = document.querySelector('#plots canvas'), { width, height } = canvas;
    const { data } = canvas.getContext('2d').getImageData(0, 0, width, height);
    const at = (y, x) => 4 * (y * width + x), columns = [...Array(width).keys()];
    const count = (y, is) => columns.filter((x) => is(data[at(y, x)], data[at(y, x) + 2])).length;
    const rows = [...Array(height).keys()].map((y) => [count(y, (red, blue) => blue > red + 60), y]);
    const [blue, y] = rows.reduce((best, one) => (one[0] > best[0] ? one : best));
    return count(y, (red, blue) => red > blue + 60) / blue;
})()"""
"""Orange pixels to a blue one, in the row that has the most of these."""
SINE_HZ, SINE_UM, EDGE_CYCLE = 66.0, 3.0, 77_777


@pytest.fixture(scope="module")
def played(tmp_path_factory):
    made = Played(tmp_path_factory.mktemp("gateway") / "control.sock")
    made.cell.problem = None
    follow(made)
    return made


@pytest.fixture(autouse=True)
def tracking(played):
    """What a test before has left."""
    played.cell.status = status()


@pytest.fixture(scope="module")
def address(played):
    tokens = Tokens([Token("ana", "operate", DO)])
    with served(Gateway(played.cell, tokens, Origins(), lambda: None)) as found:
        yield found


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    with chromium(tmp_path_factory.mktemp("chromium")) as made:
        yield made


def opened(browser, address, path):
    browser.errors.clear()
    browser.asked.clear()
    browser("Page.navigate", url=address + path)
    browser.until("document.readyState === 'complete'")


def signed_in(browser, address, path):
    """`path`, opened with the right token, which the browser may have kept from before."""
    opened(browser, address, path)
    asked, known = (
        "document.querySelector('dialog[open] #token') !== null",
        "document.getElementById('who').textContent",
    )
    browser.until(f"{asked} || {known}.includes('ana')")
    if browser.value(asked):
        browser.value(f"document.getElementById('token').value = '{DO}'")
        browser.value("document.querySelector('dialog[open] button').click()")
        browser.until(f"{known}.includes('ana')")


def in_order(browser, address):
    assert browser.errors == []
    assert len(browser.asked) > 5
    assert {
        url for url in browser.asked if not url.startswith((address, address.replace("http", "ws"), "blob:", "data:"))
    } == set()
    assert not any(DO in url for url in browser.asked), "a token is in no address"


def test_a_wrong_token_is_told_and_the_right_one_opens(browser, address):
    opened(browser, address, "/")
    browser.value("sessionStorage.clear()")
    opened(browser, address, "/")
    for token, then in (("w" * 24, "document.querySelector('dialog[open] .notice')?.hidden === false"),
                        (DO, "document.getElementById('who').textContent.includes('ana')")):  # fmt: skip
        browser.until("document.querySelector('dialog[open] input[type=password]') !== null")
        browser.value(
            f"document.getElementById('token').value = '{token}'; document.querySelector('dialog[open] button').click()"
        )
        browser.until(then)
    browser.until("document.querySelector('#state b').textContent === 'TRACKING'")
    in_order(browser, address)


def test_a_page_follows_the_system_to_dark_and_light_unless_one_was_chosen(browser, address):
    signed_in(browser, address, "/scope")
    shown = "document.documentElement.dataset.theme"
    for theme in ("dark", "light"):
        browser("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": theme}])
        browser.until(f"{shown} === '{theme}'")
    browser.value("document.getElementById('theme').click()")
    browser("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": "light"}])
    assert browser.value(shown) == "dark"
    browser.value("localStorage.removeItem('theme')")
    in_order(browser, address)


def test_the_cell_page_shows_values_and_a_fault_with_its_next_step(browser, address, played):
    signed_in(browser, address, "/")
    browser.until("document.querySelectorAll('.axis').length === 2")
    assert "51.25" in browser.value("document.querySelector('.axis').textContent")
    asked = "document.getElementById('question').open"
    browser.value("document.querySelector('[data-order=arm]').click()")
    assert browser.until(asked)
    assert browser.value("document.activeElement.value") == "no"
    browser.value("document.activeElement.click()")
    browser.until(f"!{asked}")
    played.cell.take(status("FAULT", [FAULT]))
    browser.until("document.querySelector('#state b').textContent === 'FAULT'")
    assert FAULT["next_step"] in browser.value("document.querySelector('.fault').textContent")
    disabled = "[...document.querySelectorAll('#orders button:disabled')].map((b) => b.dataset.order).join()"
    assert browser.value(disabled) == "arm"
    assert "RESET" in browser.value("document.getElementById('ordered').textContent")
    for state in ("FAULT", "NO CONTROLLER"):
        if state == "NO CONTROLLER":
            played.cell.take(None)
            played.cell.problem = "no controller answers"
        browser.until(f"document.querySelector('#state b').textContent === '{state}'")
        for width in (390, 1280):
            browser("Emulation.setDeviceMetricsOverride", width=width, height=900, deviceScaleFactor=1, mobile=False)
            assert browser.value("document.documentElement.scrollWidth <= innerWidth"), f"{state} fits at {width}"
    assert FAULT["next_step"] in browser.value("document.querySelector('.fault').textContent"), "it stays to be seen"
    played.cell.status, played.cell.problem = status(), None
    browser.until("document.querySelector('#state b').textContent === 'TRACKING'")
    browser.value("document.getElementById('seen').click()")
    browser.until("document.getElementById('faults').hidden")
    in_order(browser, address)


@pytest.mark.parametrize("path", ["/scope", "/moves"])
def test_every_page_holds_and_disarms_after_a_question(browser, address, played, path):
    signed_in(browser, address, path)
    seen = "[...document.querySelectorAll('#orders button')].filter((b) => b.offsetParent || b.offsetWidth)"
    browser.until(f"{seen}.length === 2 && {seen}.every((b) => !b.disabled)")
    assert browser.value(f"{seen}.map((b) => b.dataset.order).join()") == "hold,disarm"
    for name in ("hold", "disarm"):
        browser.value(f"document.querySelector('[data-order={name}]').click()")
        assert browser.until("document.getElementById('question').open")
        assert browser.value("document.activeElement.value") == "yes"
        browser.value("document.querySelector('#question [value=no]').click()")
    for width in (390, 1280):
        browser("Emulation.setDeviceMetricsOverride", width=width, height=900, deviceScaleFactor=1, mobile=False)
        assert browser.value("document.documentElement.scrollWidth <= innerWidth")
    played.cell.status = None
    browser.until(f"{seen}.every((b) => b.disabled)")
    in_order(browser, address)


def test_the_scope_triggers_at_the_cycle_and_reads_the_sine(browser, address, played):
    signed_in(browser, address, "/scope")
    browser.until("document.querySelectorAll('#fields input').length === 58")
    form = "const f = document.getElementById('trigger').elements"
    browser.value(
        f"{{ {form}; f.mode.value = 'single'; f.field.value = 'x.stage_um'; f.level.value = '0.5'; "
        "f.before.value = '25'; "
        "f.mode.dispatchEvent(new Event('input', {bubbles: true})) }"
    )
    browser.until("document.getElementById('armed').textContent === 'waits' || scopeFrames.length === 0")
    time.sleep(1.0)
    cycles = np.arange(100_000)
    made = rows(
        cycles, x_strain_um=SINE_UM * np.sin(2 * np.pi * SINE_HZ * cycles * 1e-4), x_stage_um=cycles >= EDGE_CYCLE
    )
    made["state"][90_000:] = states.HOLDING
    for part in np.split(made, 50):
        played.play(part)
        until(played.has_read, "the gateway has taken in what was played")
    hit = browser.until("scopeFrames.find((frame) => frame.trigger_cycle !== null)")
    assert hit["trigger_cycle"] == EDGE_CYCLE
    assert (hit["first"], hit["last"]) == (EDGE_CYCLE - 2_500, EDGE_CYCLE + 7_500)
    browser.until("document.getElementById('summary').textContent.includes('77')")
    browser.value(f"{{ {form}; f.mode.value = 'off'; f.mode.dispatchEvent(new Event('input', {{bubbles: true}})) }}")
    browser.value("{ const s = document.getElementById('span'); s.value = '5'; s.dispatchEvent(new Event('change')) }")
    browser.until("scopeFrames.at(-1).last === 99999 && scopeFrames.at(-1).first === 49999")
    assert browser.value("scopeFrames.filter((frame) => frame.lost || frame.missing)") == []
    browser.value("document.querySelector('[data-tab=spectrum]').click()")
    line = browser.until("document.getElementById('readout').textContent.match(/x.strain_um([\\d.]+) Hz: ([\\d.]+)/)")
    assert float(line[1]) == pytest.approx(SINE_HZ, rel=0.01)
    assert float(line[2]) == pytest.approx(SINE_UM, rel=0.01)
    browser.value("document.querySelector('[data-tab=xy]').click()")
    browser.until("document.querySelector('#plots canvas') !== null")
    browser.value("document.querySelector('[data-tab=time]').click()")
    for width in (390, 1280):
        browser("Emulation.setDeviceMetricsOverride", width=width, height=900, deviceScaleFactor=1, mobile=False)
        assert browser.until("document.documentElement.scrollWidth <= innerWidth", 5.0), f"it fits at {width}"
    in_order(browser, address)


def test_a_recording_is_seen_whole_and_down_to_a_millisecond_without_a_token(browser, tmp_path):
    file = written(tmp_path / "run.mcap")
    source = filed(file)
    with served(Gateway(RecordedCell(source), AnonymousTokens(), Origins(), lambda: None, home="scope")) as there:
        opened(browser, there, "/")
        whole = browser.until("window.scopeFrames?.at(-1)")
        assert whole["first"] <= source.history.oldest
        assert whole["last"] == source.history.newest
        assert browser.value("document.querySelector('dialog[open]') === null")
        browser.until("document.getElementById('summary').textContent.includes('overview so far 0 %')")
        source.history.overview.fill()
        assert browser.value(MIXED) < 0.1, "the set-point, 0, lies above the gauge's noise"
        fault = browser.until("document.querySelector('#marks .fault')?.textContent")
        browser.until("!document.getElementById('summary').textContent.includes('overview so far')")
        assert "STRAIN_INVALID" in fault
        browser.value("document.querySelector('#marks .fault').click()")
        browser.until(f"scopeFrames.at(-1).first < {FAULT_CYCLE} && scopeFrames.at(-1).last < {FAULT_CYCLE + 400}")
        for _ in range(9):
            browser.value("document.getElementById('shorter').click()")
        browser.until("scopeFrames.at(-1).last - scopeFrames.at(-1).first === 10 && scopeFrames.at(-1).rows === 1")
        browser.value("document.querySelector('[data-tab=xy]').click()")
        browser.until("document.querySelector('#plots canvas') !== null")
        for hidden in ("freeze", "trigger-card", "pages", "forget"):
            assert browser.value(f"document.getElementById('{hidden}').hidden"), hidden
        in_order(browser, there)
        browser("Page.navigate", url="about:blank")


class Mover:
    """What the controller answers to a move; it takes a few looks, or ends where it is to stop."""

    def __init__(self, begun_cycle):
        self.begun_cycle, self.asked = begun_cycle, []

    async def __call__(self, verb, name, **fields):
        self.asked.append((verb, name, fields))
        if fields.get("stop"):
            raise CheckFailed("the move was stopped: as was asked for; the axis is held 1.5 um from where it began")
        looks = len([told for _, _, told in self.asked if "number" in told])
        answer = {"number": 1, "done": looks > 2 and looks < 50, "progress": 0.5, "seconds": 1.4, "offset_um": 0.0}
        return answer | {"begun_cycle": self.begun_cycle}


def test_a_move_is_made_after_a_question_only_while_held_and_its_response_is_read_off(browser, tmp_path):
    mine = Played(tmp_path / "control.sock")
    mine.cell.status, mine.cell.problem = status("TRACKING"), None
    cycles = np.arange(40_000)
    passed = np.clip((cycles - 20_000) / 2000.0, 0.0, 1.0)
    course = 60.0 + 4.0 * passed**3 * (10.0 + passed * (6.0 * passed - 15.0))
    for part in np.split(rows(cycles, x_setpoint_um=course, x_strain_um=course + 0.25), 20):
        mine.play(part)
        mine.cell.source.read()
    mine.cell.order = mover = Mover(20_000)

    async def follow():
        while True:
            mine.cell._notify(None)
            await asyncio.sleep(0.05)

    mine.cell.follow = follow
    begin, said = "document.getElementById('begin')", "document.getElementById('said').textContent"
    with served(Gateway(mine.cell, Tokens([Token("ana", "operate", DO)]), Origins(), lambda: None)) as there:
        signed_in(browser, there, "/moves")
        browser.until(f"{said}.includes('the state is TRACKING')")
        assert browser.value(f"{begin}.disabled")
        mine.cell.status = status("HOLDING")
        for answer in ("no", "yes"):
            browser.until(f"!{begin}.disabled")
            browser.value(f"document.getElementById('move').elements.by_um.value = '4'; {begin}.click()")
            browser.until("document.getElementById('question').open")
            assert browser.value("document.activeElement.value") == "no"
            assert mover.asked == []
            browser.value(f"document.querySelector('#question [value={answer}]').click()")
            browser.value("new Promise((done) => setTimeout(done, 200))")  # until the page has heard that it is closed
        browser.until(f"{said}.startsWith('done')")
        wanted = {"axis": "x", "kind": "step", "by_um": 4, "way_s": 0.2, "rest_s": 0.5, "returns": True}
        assert mover.asked[0] == ("move", "ana", wanted)
        figures = browser.until("document.getElementById('figures').textContent")
        legends = "[...document.querySelectorAll('.legend')].map((each) => each.textContent)"
        assert browser.value(legends)[0] == "set-pointstrain gauge"
        assert "overshoot0%" in figures.replace("0.000", "0")
        assert "rms0.2500" in figures
        mover.asked = [("", "", {"number": 1})] * 60
        browser.until(f"!{begin}.disabled")
        browser.value(f"{begin}.click(); document.querySelector('#question [value=yes]').click()")
        browser.until("!document.getElementById('stop').disabled")
        browser.value("document.dispatchEvent(new KeyboardEvent('keydown', {key: 'Escape'}))")
        browser.until(f"{said}.startsWith('the move was stopped')")
        assert mover.asked[-1][2] == {"number": 1, "stop": True}
        browser.until(f"!{begin}.disabled")
        browser.value("window.fetch = () => Promise.reject(new TypeError('Failed to fetch'))")  # the gateway is killed
        browser.value(f"{begin}.click(); document.querySelector('#question [value=yes]').click()")
        browser.until(f"{said}.includes('whether this was done is not known')")
        for width in (390, 1280):
            browser("Emulation.setDeviceMetricsOverride", width=width, height=900, deviceScaleFactor=1, mobile=False)
            assert browser.until("document.documentElement.scrollWidth <= innerWidth", 5.0), f"it fits at {width}"
        browser.errors[:] = [error for error in browser.errors if "409" not in error.get("text", "")]
        in_order(browser, there)
        browser("Page.navigate", url="about:blank")
