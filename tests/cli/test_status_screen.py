"""The screen of ``micromanip status --watch`` before a played controller, driven by textual's own pilot."""

import asyncio

import pytest

from micromanip.cli.status_screen import Question, StatusScreen

from .command import code_of
from .played import Played, status

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
        app = StatusScreen(controller.path)
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


def test_without_a_terminal_it_is_refused(played, capsys):
    assert code_of("status", "--watch", "--socket", played.path) == 64
    assert "`micromanip get --watch NAME...` prints a line a sample elsewhere" in capsys.readouterr().err
