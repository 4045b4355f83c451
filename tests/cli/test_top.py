"""The screen of ``micromanip top`` before a played controller, driven by textual's own pilot."""

import asyncio

import pytest
from textual.widgets import Static

from micromanip.cli.main import main
from micromanip.cli.top_screen import Question, Top
from micromanip.cli.trace import Trace, bars

from .played import FAULT, Played, status

WIDTHS = [40, 120]
VERBS = {"a": "arm", "h": "hold", "d": "disarm", "r": "reset"}


@pytest.fixture
def played(tmp_path):
    controller = Played(tmp_path / "control.sock")
    yield controller
    controller.close()


def shown(app):
    """What stands on the screen, line by line."""
    return ["".join(segment.text for segment in strip) for strip in app.screen._compositor.render_strips()]


def played_on(controller, script, width=120, height=60):
    """Run `script(pilot, see)` on a screen; `see(text)` waits until that is shown."""

    async def play():
        app = Top(controller.path)
        async with app.run_test(size=(width, height)) as pilot:

            async def see(*texts):
                for _ in range(200):
                    screen = "\n".join(shown(app))
                    if all(text in screen for text in texts):
                        return screen
                    await pilot.pause(0.05)
                raise AssertionError(f"{texts} are not shown:\n{screen}")

            await script(pilot, see)

    asyncio.run(play())


@pytest.mark.parametrize("width", WIDTHS)
def test_state_values_and_error_are_shown_whole(played, width):
    async def script(pilot, see):
        await see("T R A C K I N G")
        values = "51.250", "66.500", "66.000", "100.000", "50.000", "-0.250", "x     1.25 um", "y     1.25 um"
        screen = await see(*values, "r reset", "q quit")
        for figure in ("0.125", "0.375", "0.500", "1.250"):
            assert figure in screen
        assert "…" not in screen, "nothing is cut"

    played_on(played, script, width, height=100)


@pytest.mark.parametrize("width", WIDTHS)
def test_a_fault_is_red_and_has_its_next_step(played, width):
    played.status = status("FAULT", [FAULT])

    async def script(pilot, see):
        await see("F A U L T", "X-201 axis x", "next: Look at the gauge")
        bar = pilot.app.query_one("#state", Static)
        assert bar.styles.background.hex == "#C01818"
        colour = pilot.app.query_one("#faults", Static).styles.color
        assert colour.r > 1.3 * max(colour.g, colour.b), "red, in the colours of the theme"

    played_on(played, script, width)


def test_what_is_not_known_is_said_and_is_no_number(played):
    played.status = status("READY", position=(None, "stale: no usable sample of stage_x for 4 ms"))

    async def script(pilot, see):
        screen = await see("R E A D Y", "unknown: x position, y position: stale: no usable sample of stage_x")
        row = next(line for line in screen.splitlines() if "position, um" in line)
        assert "stale" in row
        assert not any(character.isdigit() for character in row)

    played_on(played, script)


@pytest.mark.long  # draws some thirty screens
def test_a_key_asks_and_only_yes_sends(played):
    async def script(pilot, see):
        await see("T R A C K I N G")
        for key, no in (("a", "n"), ("h", "escape"), ("d", "enter"), ("r", "q")):
            await pilot.press(key)
            await see("(y) yes   (n) no")
            await pilot.press(no)
            await pilot.pause()
            assert not isinstance(pilot.app.screen, Question)
        assert played.orders == []
        for key, verb in VERBS.items():
            await pilot.press(key)
            await pilot.press("y")
            await see(f"{verb}: done")
        assert played.orders == [*VERBS.values()]

    played_on(played, script)


def test_a_refusal_is_shown_with_its_reason(played):
    played.refuses = "arm refused: the state is TRACKING"

    async def script(pilot, see):
        await see("T R A C K I N G")
        await pilot.press("a", "y")
        await see("arm refused: the state is TRACKING")

    played_on(played, script)


def test_a_controller_that_goes_is_said_and_found_again(played):
    async def script(pilot, see):
        await see("T R A C K I N G", "51.250")
        played.close()
        screen = await see("N O   C O N T R O L L E R", "trying again")
        assert "51.250" not in screen, "an old number is no value"
        played.status = status("READY")
        played.open()
        await see("R E A D Y", "51.250")

    played_on(played, script)


def test_q_ends_it(played):
    async def script(pilot, see):
        await see("T R A C K I N G")
        await pilot.press("q")
        await pilot.pause()
        assert not pilot.app.is_running

    played_on(played, script)
    assert played.orders == [], "leaving it changes nothing"


def test_bars_of_a_trace():
    assert bars([0.0, 1.0, 2.0, None, 4.0, 8.0], 8.0) == "▁▂▃ ▅█"
    assert bars([0.0, 0.0], 0.0) == "▁▁"


@pytest.mark.parametrize("width", [30, 40, 120])
def test_a_trace_fills_its_line_and_shows_the_newest(width):
    trace = Trace()
    for number in range(500):
        trace.add(float(number))
    line = trace.line("x", "um", width)
    assert len(line) == width
    assert line.startswith("x      499 um ")
    assert line.endswith("█")


def test_a_trace_of_nothing_known_has_no_figure():
    trace = Trace()
    trace.add(None)
    assert trace.line("x", "um", 30).split() == ["x", "unknown", "um"]


def test_without_a_terminal_it_says_what_does(tmp_path, capsys):
    with pytest.raises(SystemExit) as ended:
        main(["top", "--socket", str(tmp_path / "none")])
    assert ended.value.code == 64
    assert "status --watch" in capsys.readouterr().err
