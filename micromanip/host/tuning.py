"""What runs, and how it is changed: a set of values is taken whole at one cycle boundary, or not at all."""

from __future__ import annotations

import asyncio
import difflib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Protocol

from micromanip.answers import Change, Difference, Differences, Jogged, Parameter, Saved, Swap
from micromanip.errors import CheckFailed, ConfigError, PermissionDenied, UsageError
from micromanip.rt.states import FAULT, OFF, READY, STATE_NAMES, TRACKING
from micromanip.settings.change import ABSENT, DISARM, LIVE, changed, needed, needs, values
from micromanip.settings.check import Prepared, revise, validate
from micromanip.settings.commissioned import changes_since
from micromanip.settings.keys import assigned, selected
from micromanip.settings.load import validate_document
from micromanip.settings.model import Configuration
from micromanip.settings.place import Path as KeyPath
from micromanip.settings.reference import Jog
from micromanip.settings.source import Source, key_text
from micromanip.settings.wiring import driver_options
from micromanip.settings.write import write_atomically
from micromanip.settings.write_values import with_values

AT_REST = tuple(STATE_NAMES[state] for state in (OFF, READY, FAULT))


class Tunable(Protocol):
    """What runs: `micromanip.host.controller.Controller`."""

    prepared: Prepared

    @property
    def state(self) -> str:
        """Name of the cell's state."""

    async def adopt(self, prepared: Prepared, permit: Callable[[], None]) -> int:
        """Swap to `prepared` once `permit` has not raised, with no command in between; the version in force."""


class Tuning:
    """Values of one running controller, and the file that they were read from."""

    def __init__(self, controller: Tunable, tell: Callable[[Source], None]) -> None:
        """`tell` hears of each configuration that has come into force, or has been written to the file."""
        self._tell = tell
        prepared = controller.prepared
        self._controller = controller
        self._file = prepared.source
        same = _configuration(self._file) == prepared.configuration
        self._document = self._file.data if same else prepared.configuration.model_dump(mode="json")
        self._one_at_a_time = asyncio.Lock()

    @property
    def _running(self) -> Prepared:
        return self._controller.prepared

    async def get(self, keys: Sequence[str]) -> list[Parameter]:
        """Running values of `keys`, of all below where one is a section; all values without keys."""
        return await asyncio.to_thread(_parameters, self._running.configuration, keys)

    async def set(self, wanted: Mapping[str, Any]) -> Swap:
        """Change the values of some keys; UsageError, ConfigError or CheckFailed says each reason why not."""
        async with self._one_at_a_time:
            known = self._running.configuration.model_dump(mode="json")
            document = await asyncio.to_thread(assigned, self._document, known, wanted)
            return await self._swap(Source.of(document, self._file.path))

    async def jog(self, axis: str, *, by_um: float | None, to_um: float | None) -> tuple[Jogged, Change]:
        """Send `axis` to another target while TRACKING; CheckFailed or ConfigError says why not."""
        async with self._one_at_a_time:
            configuration = self._running.configuration
            reference = configuration.reference
            if not isinstance(reference, Jog):
                raise CheckFailed(f"jog refused: reference.source is {reference.source}, not jog")
            if axis not in configuration.axes:
                near = difflib.get_close_matches(axis, configuration.axes, 1)
                hint = f"did you mean {near[0]}?" if near else f"there are {', '.join(configuration.axes)}"
                raise UsageError(f"there is no axis {axis!r:.40}; {hint}")
            present_um = reference.target_um.get(axis, reference.offset_um)
            target_um = present_um + (by_um or 0.0) if to_um is None else to_um
            known = configuration.model_dump(mode="json")
            key = f"reference.target_um.{axis}"
            document = assigned(self._document, known, {key: target_um})
            await self._swap(Source.of(document, self._file.path), self._tracks)
            return Jogged(axis=axis, target_um=target_um), Change(key=key, old=present_um, new=target_um)

    def _tracks(self) -> None:
        state = self._controller.state
        if state != STATE_NAMES[TRACKING]:
            raise CheckFailed(f"jog refused: the state is {state}; an axis is jogged while TRACKING")

    async def reload(self) -> Swap:
        """Take over the file as it is now; errors as `set`, and nothing changed where one key of it can't be taken."""
        async with self._one_at_a_time:
            source = await asyncio.to_thread(Source.read, self._file.path)
            swap = await self._swap(source)
            self._keep(source)
            return swap

    async def diff(self) -> Differences:
        """The file on disk against what runs; ConfigError where the file is not valid as it is."""
        source = await asyncio.to_thread(Source.read, self._file.path)
        on_disk = await asyncio.to_thread(validate, source)
        found = changed(on_disk, self._running.configuration)
        return Differences(
            file=str(source.path),
            changed_on_disk=source.hash != self._file.hash,
            differences=[
                Difference(key=key_text(path), file=_shown(file), running=_shown(running), change=needed(path))
                for path, (file, running) in found.items()
            ],
        )

    async def save(self, *, force: bool) -> Saved:
        """Write the running values into the file.

        Raises CheckFailed where it was changed on disk and not `force`, PermissionDenied where it can't be written.
        """
        async with self._one_at_a_time:
            on_disk = await asyncio.to_thread(Source.read, self._file.path)
            if on_disk.hash != self._file.hash and not force:
                raise CheckFailed(
                    f"{on_disk.path} was changed on disk since it was loaded: see `micromanip diff`; `reload` takes "
                    "over its values, `save --force` writes the running ones into it"
                )
            saved = await asyncio.to_thread(_written, on_disk, self._document)
            self._keep(saved)
            old, running = validate_document(on_disk), self._running.configuration
            return Saved(file=str(saved.path), sha256=saved.hash, changed=_changes(old, running))

    def _keep(self, source: Source) -> None:
        """`source` is the file now, and says what runs."""
        self._file, self._document = source, source.data
        self._controller.prepared = replace(self._running, source=source)
        self._tell(source)

    async def _swap(self, source: Source, permit: Callable[[], None] = lambda: None) -> Swap:
        permit()
        old = self._running.configuration
        revised, disarmed = await asyncio.to_thread(self._revised, source)

        def decide() -> None:
            permit()
            self._refuse(disarmed)

        version = await self._controller.adopt(revised, decide)
        self._document = source.data
        self._tell(revised.source)
        new = revised.configuration
        warnings = [text for text in changes_since(new.axes) if text not in changes_since(old.axes)]
        return Swap(version=version, changed=_changes(old, new), warnings=warnings)

    def _revised(self, source: Source) -> tuple[Prepared, dict[KeyPath, str]]:
        """`source` ready to run, and those of its changes that must find the outputs at rest."""
        running = self._running
        configuration = validate(source)
        for name, entry in configuration.drivers.items():
            driver_options(source, name, entry)
        wanted = {path: what for path, what in needs(running.configuration, configuration).items() if what != LIVE}
        self._refuse(wanted)
        revised = revise(running, source)
        if source.data == self._file.data:  # back to what the file says
            revised = replace(revised, source=self._file)
        return revised, wanted

    def _refuse(self, wanted: Mapping[KeyPath, str]) -> None:
        """Raise CheckFailed where the present state does not allow one of the changes; it names each."""
        state = self._controller.state
        refused = {p: what for p, what in wanted.items() if what != DISARM or state not in AT_REST}
        if refused:
            reasons = "; ".join(f"{key_text(path)} {what}" for path, what in refused.items())
            raise CheckFailed(f"nothing was changed, the state is {state}: {reasons}")


def _parameters(configuration: Configuration, keys: Sequence[str]) -> list[Parameter]:
    leaves = values(configuration)
    paths = selected(leaves, configuration.model_dump(mode="json"), keys)
    return [Parameter(key=key_text(path), value=leaves[path], change=needed(path)) for path in paths]


def _written(file: Source, document: Mapping[str, Any]) -> Source:
    """`file` after `document` was written into it; PermissionDenied where it can't be."""
    text = with_values(file, document)
    try:
        write_atomically(file.path.resolve(), text)
    except OSError as problem:
        raise PermissionDenied(f"{file.path} can't be written: {problem.strerror}") from problem
    return Source.parse(file.path, text)


def _configuration(source: Source) -> Configuration | None:
    try:
        return validate_document(source)
    except ConfigError:
        return None


def _changes(old: Configuration, new: Configuration) -> list[Change]:
    return [
        Change(key=key_text(path), old=_shown(before), new=_shown(after))
        for path, (before, after) in changed(old, new).items()
    ]


def _shown(value: Any) -> Any:
    return None if value is ABSENT else value
