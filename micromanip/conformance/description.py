"""What a driver says of itself is complete, consistent, and the same each time."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence

from micromanip.bus.driver import BusDriver, Channel
from micromanip.bus.registry import findings

from .hooks import Hooks
from .lifetime import descriptors
from .session import Session


class DescriptionChecks(Hooks):
    """Checks that need no device."""

    def test_class_keeps_the_contract(self) -> None:
        """What ``micromanip device list`` looks at too."""
        found = findings(self.driver)
        assert not found, "; ".join(found)

    def test_building_opens_nothing(self) -> None:
        peer = self.peer()
        self.make(peer)
        before = descriptors()
        built = self.make(peer)
        after = descriptors()
        assert after <= before, f"{type(built).__name__}.__init__ opened a descriptor; that is for open"

    def test_unknown_option_is_refused(self) -> None:
        refusal = None
        try:
            self.driver.Options.model_validate({**self.peer().options, "no_such_key": 1})
        except ValueError as problem:
            refusal = str(problem)
        assert refusal, "the options accept the unknown key no_such_key: a typing error would pass"
        assert "no_such_key" in refusal, "the options refuse an unknown key, and don't say which"

    def test_channels(self) -> None:
        driver = self.make(self.peer())
        for kind, channels in (("input", driver.inputs), ("output", driver.outputs)):
            twice = _twice(channel.name for channel in channels)
            assert not twice, f"two {kind}s are called {twice}"
            for channel in channels:
                _look_at(kind, channel)
        assert driver.inputs or driver.outputs, "a driver without inputs and outputs does nothing"

    def test_every_output_is_written_by_one_task(self) -> None:
        driver = self.make(self.peer())
        written = Counter(index for task in driver.tasks for index in task.outputs)
        stray = sorted(set(written) - set(range(len(driver.outputs))))
        assert not stray, f"tasks write outputs {stray}; there are 0 to {len(driver.outputs) - 1}"
        for index, channel in enumerate(driver.outputs):
            assert written[index] == 1, f"output {channel.name} is written by {written[index]} tasks, not by one"

    def test_tasks_have_names_and_rates(self) -> None:
        driver = self.make(self.peer())
        twice = _twice(task.name for task in driver.tasks)
        assert not twice, f"two tasks are called {twice}"
        for task in driver.tasks:
            assert task.name, "a task has no name"
            assert _positive(task.rate_hz), f"task {task.name} has the rate {task.rate_hz}"
            for index in (index for index in task.outputs if index < len(driver.outputs)):
                channel = driver.outputs[index]
                assert math.isclose(channel.rate_hz, task.rate_hz, rel_tol=0.01), (
                    f"output {channel.name} declares {channel.rate_hz:g} Hz, its task {task.name} {task.rate_hz:g} Hz"
                )

    def test_loads(self) -> None:
        loads = self.make(self.peer()).loads()
        assert loads, "loads() names nothing that carries the channels"
        twice = _twice(load.name for load in loads)
        assert not twice, f"two loads are called {twice}: add up what one resource carries"
        for load in loads:
            assert load.name, "a load has no name"
            assert load.detail, f"load {load.name} does not say how it comes about"
            assert math.isfinite(load.share), f"load {load.name} has the share {load.share}"
            assert 0 < load.limit <= 1, f"load {load.name} has the limit {load.limit}; 1 is all"
            assert 0 < load.share <= load.limit, (
                f"load {load.name} is {load.share:.3g} of a limit of {load.limit:.3g}; the suite's peer must be one "
                "that the bus can carry, and what is used is more than nothing"
            )

    def test_device_and_watchdog_are_named(self) -> None:
        driver = self.make(self.peer())
        assert isinstance(driver.device, str), f"device is {driver.device!r}, not a text"
        assert driver.device, "device is empty: two controllers could take the same hardware"
        assert driver.watchdog is None or (isinstance(driver.watchdog, str) and driver.watchdog), (
            f"watchdog is {driver.watchdog!r}; a few words, or None if nothing covers a dead machine"
        )

    def test_description_never_changes(self) -> None:
        with self.device() as peer:
            driver = self.make(peer)
            built = _all_of(driver)
            with Session(driver) as session:
                assert _all_of(driver) == built, "channels, tasks or loads are other ones after open than before"
                session.run(0.05)
                assert _all_of(driver) == built, "channels, tasks or loads changed while it ran"
            assert _all_of(driver) == built, "channels, tasks or loads changed by close"


def _look_at(kind: str, channel: Channel) -> None:
    assert channel.name, f"an {kind} has no name"
    assert _positive(channel.rate_hz), f"{kind} {channel.name} has the rate {channel.rate_hz}"
    assert math.isfinite(channel.latency_s), f"{kind} {channel.name} has the latency {channel.latency_s}"
    assert channel.latency_s >= 0, f"{kind} {channel.name} has the latency {channel.latency_s:g} s"
    assert math.isfinite(channel.safe), f"{kind} {channel.name} has the safe value {channel.safe}"


def _positive(rate_hz: float) -> bool:
    return math.isfinite(rate_hz) and rate_hz > 0


def _twice(names: Iterable[str]) -> str:
    return ", ".join(name for name, count in Counter(names).items() if count > 1)


def _all_of(driver: BusDriver) -> list[Sequence[object]]:
    return [list(driver.inputs), list(driver.outputs), list(driver.tasks), list(driver.loads())]
