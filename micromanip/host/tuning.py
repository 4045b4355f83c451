"""What runs, and how it is changed: a set of values is taken whole at one cycle boundary, or not at all."""

from __future__ import annotations

import asyncio
import difflib
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from micromanip.errors import CheckFailed, UsageError, system_error
from micromanip.replies import Change, Differences, Jogged, Parameter, Saved, Swap
from micromanip.rt.states import FAULT, OFF, READY, STATE_NAMES, TRACKING
from micromanip.settings.change import DISARM
from micromanip.settings.check import validate
from micromanip.settings.commissioned import changes_since
from micromanip.settings.load import validate_document
from micromanip.settings.protection import WEAKENS
from micromanip.settings.schema.reference import Jog
from micromanip.settings.text.keys import assigned
from micromanip.settings.text.place import Path as KeyPath
from micromanip.settings.text.source import Source, key_text
from micromanip.settings.write import write_atomically
from micromanip.settings.write_values import with_values

from .differences import changes, differences, parameters
from .running import Running

AT_REST = tuple(STATE_NAMES[state] for state in (OFF, READY, FAULT))


class Tuning:
    """Values of one running controller, and the file that they were read from."""

    def __init__(self, running: Running) -> None:
        self._running = running

    async def get(self, keys: Sequence[str]) -> list[Parameter]:
        """Running values of `keys`, of all below where one is a section; all values without keys."""
        self._running.notice()
        return await asyncio.to_thread(parameters, self._running.prepared.configuration, keys)

    async def set(self, wanted: Mapping[str, Any]) -> Swap:
        """Change the values of some keys; UsageError, ConfigError or CheckFailed says each reason why not."""
        async with self._running.changing():
            known = self._running.prepared.configuration.model_dump(mode="json")
            document = await asyncio.to_thread(assigned, self._running.document, known, wanted)
            return await self._swap(Source.of(document, self._running.file.path))

    async def jog(self, axis: str, *, by_um: float | None, to_um: float | None) -> tuple[Jogged, Change]:
        """Send `axis` to another target while TRACKING; CheckFailed or ConfigError says why not."""
        async with self._running.changing():
            configuration = self._running.prepared.configuration
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
            document = assigned(self._running.document, known, {key: target_um})
            await self._swap(Source.of(document, self._running.file.path), self._tracks)
            return Jogged(axis=axis, target_um=target_um), Change(key=key, old=present_um, new=target_um)

    def _tracks(self) -> None:
        state = self._running.controller.state
        if state != STATE_NAMES[TRACKING]:
            raise CheckFailed(f"jog refused: the state is {state}; an axis is jogged while TRACKING")

    async def reload(self) -> Swap:
        """Take over the file as it is now; errors as `set`, and nothing changed where one key of it can't be taken."""
        async with self._running.changing():
            source = await asyncio.to_thread(Source.read, self._running.file.path)
            swap = await self._swap(source)
            self._running.keep(source)
            return swap

    async def diff(self) -> Differences:
        """The file on disk against what runs; ConfigError where the file is not valid as it is."""
        source = await asyncio.to_thread(Source.read, self._running.file.path)
        on_disk = await asyncio.to_thread(validate, source)
        self._running.notice()
        return Differences(
            file=str(source.path),
            changed_on_disk=source.hash != self._running.file.hash,
            differences=differences(on_disk, self._running.prepared.configuration),
        )

    async def save(self, *, force: bool) -> Saved:
        """Write the running values into the file.

        Raises CheckFailed where it was changed on disk and not `force`, PermissionDenied where it can't be written.
        """
        async with self._running.changing():
            on_disk = await asyncio.to_thread(Source.read, self._running.file.path)
            if on_disk.hash != self._running.file.hash and not force:
                raise CheckFailed(
                    f"{on_disk.path} was changed on disk since it was loaded: see `micromanip diff`; `reload` takes "
                    "over its values, `save --force` writes the running ones into it"
                )
            saved = await asyncio.to_thread(_written, on_disk, self._running.document)
            self._running.keep(saved)
            old, running = validate_document(on_disk), self._running.prepared.configuration
            return Saved(file=str(saved.path), sha256=saved.hash, changed=changes(old, running))

    async def _swap(self, source: Source, permit: Callable[[], None] = lambda: None) -> Swap:
        self._running.refuse_on_trial()
        permit()
        old = self._running.prepared.configuration
        revised, disarmed = await self._running.revised(source, self._refuse)

        def decide() -> None:
            permit()
            self._refuse(disarmed)

        version = await self._running.swap(revised, decide)
        new = revised.configuration
        warnings = [text for text in changes_since(new.axes) if text not in changes_since(old.axes)]
        return Swap(version=version, changed=changes(old, new), warnings=warnings)

    def _refuse(self, wanted: Mapping[KeyPath, str]) -> None:
        """Raise CheckFailed where the present state does not allow one of the changes; it names each."""
        state = self._running.controller.state
        refused = {p: what for p, what in wanted.items() if what not in (DISARM, WEAKENS) or state not in AT_REST}
        if refused:
            reasons = "; ".join(f"{key_text(path)} {what}" for path, what in refused.items())
            raise CheckFailed(f"nothing was changed, the state is {state}: {reasons}")


def _written(file: Source, document: Mapping[str, Any]) -> Source:
    """`file` after `document` was written into it; PermissionDenied or DeviceUnavailable where it can't be."""
    text = with_values(file, document)
    try:
        write_atomically(file.path, text)
    except OSError as problem:
        raise system_error(problem, f"{file.path} can't be written") from problem
    return Source.parse(file.path, text)
