"""A link that is lost is noticed, said in the contract's words, and can be had again."""

from __future__ import annotations

from micromanip.bus.errors import LinkError

from .hooks import Hooks, errors_text
from .session import TURNS_AFTER_SILENCE, Session

_CALLS = 300
_PACE_S = 0.01


class LinkChecks(Hooks):
    """What happens when the device is switched off."""

    def test_dead_device_is_a_lost_link(self) -> None:
        with self.running() as (peer, session):
            session.fresh()
            peer.kill()
            assert _lost(session), (
                f"no LinkError in {_CALLS} rounds of perform and receive ({_CALLS * _PACE_S:g} s) after the device "
                f"went away; errors: {errors_text(session.errors[-3:])}"
            )

    def test_reopened_after_a_lost_link(self) -> None:
        with self.running() as (peer, session):
            session.fresh()
            for _ in range(2):
                peer.kill()
                _lost(session)
                session.driver.close()
                peer.start()
                session.open()
                assert session.fresh(2.0) or not session.inputs, (
                    f"no samples after the device came back; errors: {errors_text(session.errors)}"
                )

    def test_closed_driver_raises_bus_errors_only(self) -> None:
        """A worker that is late must not die of it."""
        with self.device() as peer:
            session = Session(self.make(peer))
            for _ in range(2):
                session.receive(0.0)
                session.perform_all()
                with session:
                    pass

    def test_flapping_device_raises_bus_errors_only(self) -> None:
        with self.running() as (peer, session):
            for _ in range(5):
                peer.kill()
                for _ in range(3):  # the first that finds nobody may not be told
                    session.perform_all()
                session.receive(0.01)
                peer.start()
                session.perform_all()
                session.receive(0.01)

    def test_silent_device_is_no_bug(self) -> None:
        with self.running() as (peer, session):
            peer.silence(True)
            session.run(0.5)
            peer.silence(False)
            for _ in range(TURNS_AFTER_SILENCE):
                session.open_again_if_lost()
                if session.fresh(2.0) or not session.inputs:
                    return
            raise AssertionError(f"no samples after a silence of 0.5 s; errors: {errors_text(session.errors)}")


def _lost(session: Session) -> bool:
    """Go on until the driver says that the link is lost; False if it never does."""
    for _ in range(_CALLS):
        errors = [*session.perform_all(), session.receive(_PACE_S)]
        if any(isinstance(error, LinkError) for error in errors):
            return True
    return False
