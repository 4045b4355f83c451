"""Which driver fills which place of the process image: the configuration's names resolved to indices."""

from __future__ import annotations

from dataclasses import dataclass

from pydantic import BaseModel

from micromanip.bus.bridge import BusBridge
from micromanip.bus.cyclic import CyclicDriver
from micromanip.bus.driver import BusDriver, BusOptions
from micromanip.bus.registry import driver_class
from micromanip.bus.safe_state import LAST_SWITCH, SWITCH, UNUSED, VOLTAGE, SafeOutput
from micromanip.errors import ConfigError, did_you_mean
from micromanip.rt.records import MAX_OUTPUTS, MAX_SIGNALS
from micromanip.settings.load import validate_section
from micromanip.settings.schema.model import Configuration, Driver, Output, Signal, Simulation, Switch
from micromanip.settings.text.place import Path
from micromanip.settings.text.source import Source

_SAFE_SWITCHES = {
    "amplifier_enable": SafeOutput(LAST_SWITCH, 0.0, 0.0, 1.0),
    "amplifier_reset": SafeOutput(SWITCH, 0.0, 0.0, 1.0),
    "feed_hold": SafeOutput(SWITCH, 1.0, 0.0, 1.0),
    "heartbeat": SafeOutput(SWITCH, 0.0, 0.0, 1.0),
}
"""The amplifier stays on until the voltages are at rest; the machine is asked at once to stop feeding."""


@dataclass(frozen=True)
class Wiring:
    """Drivers in the order in which the loop calls them, and the image index of each name."""

    drivers: dict[str, CyclicDriver]
    options: dict[str, BaseModel]
    first_input: dict[str, int]
    first_output: dict[str, int]
    signals: dict[str, int]
    outputs: dict[str, int]
    switches: dict[str, int]

    @property
    def devices(self) -> frozenset[str]:
        """The hardware that the drivers own."""
        return frozenset(device for driver in self.drivers.values() for device in driver.devices)

    @property
    def buses(self) -> dict[str, BusBridge]:
        """Those of the drivers that run in a worker process."""
        return {name: driver for name, driver in self.drivers.items() if isinstance(driver, BusBridge)}

    @property
    def real(self) -> list[str]:
        """Names of the drivers that move a real stage."""
        return [name for name, driver in self.drivers.items() if not driver.simulated]

    @property
    def virtual(self) -> bool:
        """Whether the whole cell can run in virtual time."""
        return all(driver.virtual for driver in self.drivers.values())

    def bus_options(self, name: str) -> BusOptions:
        """Options of the bus called `name`."""
        options = self.options[name]
        assert isinstance(options, BusOptions)
        return options

    def safe_outputs(self, name: str, configuration: Configuration) -> list[SafeOutput]:
        """How each output of the driver called `name` comes to rest, and its limits; in the order of the driver."""
        driver, first = self.drivers[name], self.first_output[name]
        safe = {channel.name: channel.safe for channel in driver.slow_outputs}
        result = [SafeOutput(UNUSED, safe.get(channel, 0.0)) for channel in driver.outputs]
        for output, index in self.outputs.items():
            if 0 <= index - first < len(result):
                settings = configuration.outputs[output]
                slew_V_per_s = 1e3 * settings.slew_V_per_ms
                result[index - first] = SafeOutput(VOLTAGE, settings.park_V, *settings.range_V, slew_V_per_s)
        for switch, index in self.switches.items():
            if 0 <= index - first < len(result):
                result[index - first] = _SAFE_SWITCHES[switch]
        return result

    def places(self, name: str) -> dict[str, int]:
        """Outputs and switches of the configuration that are on the driver called `name`, and their places there."""
        first, count = self.first_output[name], len(self.drivers[name].outputs)
        indices = {**self.outputs, **self.switches}
        return {output: index - first for output, index in indices.items() if 0 <= index - first < count}

    def signal(self, name: str) -> int:
        """Index of a signal, -1 where the configuration does not have it."""
        return self.signals.get(name, -1)


def _channel(
    source: Source, section: str, name: str, entry: Signal | Output | Switch, drivers: dict[str, CyclicDriver]
) -> tuple[str, int]:
    if entry.driver not in drivers:
        raise source.error(
            (section, name, "driver"),
            f"there is no driver {entry.driver}; the section drivers has {', '.join(drivers)}",
        )
    driver = drivers[entry.driver]
    channels = driver.inputs if section == "signals" else driver.outputs
    wanted = entry.channel or name
    if wanted not in channels:
        hint = did_you_mean(wanted, channels)
        raise source.error((section, name), f"driver {entry.driver} has no channel {wanted}; {hint}")
    return entry.driver, channels.index(wanted)


def kind_of(source: Source, path: Path, entry: Driver | Simulation) -> type[CyclicDriver] | type[BusDriver]:
    """Class of the driver of the section at `path`; ConfigError where there is none."""
    try:
        return driver_class(entry.driver)
    except ConfigError as problem:
        raise source.error((*path, "driver"), str(problem)) from problem


def driver_options(source: Source, name: str, entry: Driver) -> tuple[type[CyclicDriver] | type[BusDriver], BaseModel]:
    """Class and validated options of the driver called `name`; ConfigError where one of them is wrong."""
    kind = kind_of(source, ("drivers", name), entry)
    return kind, validate_section(source, ("drivers", name), kind.Options, entry.options)


def _seeded(options: BaseModel, seed: int | None) -> BaseModel:
    """The same with another seed, where that is asked for and they have one."""
    has_seed = seed is not None and "seed" in type(options).model_fields
    return options.model_copy(update={"seed": seed}) if has_seed else options


def build_plant(configuration: Configuration, source: Source, period_ns: int, seed: int | None = None) -> CyclicDriver:
    """The simulated cell that stands behind the devices that are played; `seed` replaces its own.

    Raises ConfigError with file, line and key: also where there is no such section, or its driver moves a real stage.
    """
    section, path = configuration.simulation, ("simulation",)
    if section is None:
        raise source.error(
            (),
            "there is no section simulation, which says what plant stands behind the devices; "
            "write `simulation: {}` for one with all its defaults",
        )
    kind = kind_of(source, path, section)
    if not (issubclass(kind, CyclicDriver) and kind.simulated):
        raise source.error((*path, "driver"), f"{section.driver} moves a real stage; the plant must be a simulation")
    options = _seeded(validate_section(source, path, kind.Options, section.options), seed)
    try:
        return kind(options, period_ns)
    except ConfigError as problem:
        raise source.error(path, str(problem)) from problem


def build_driver(
    source: Source, name: str, entry: Driver, period_ns: int, silent_ns: int, seed: int | None = None
) -> tuple[CyclicDriver, BaseModel]:
    """The driver that the configuration calls `name`, and its options; raises ConfigError with file, line and key.

    A bus counts as lost when its worker has been silent for `silent_ns`.
    """
    kind, options = driver_options(source, name, entry)
    options = _seeded(options, seed)
    try:
        if issubclass(kind, BusDriver):
            assert isinstance(options, BusOptions)
            return BusBridge(kind(options, source.path.parent), options, silent_ns), options
        driver = kind(options, period_ns)
        driver.check_files(source.path.parent)
    except ConfigError as problem:
        raise source.error_below(("drivers", name), str(problem)) from problem
    return driver, options


def wire(configuration: Configuration, source: Source, seed: int | None = None) -> Wiring:
    """Build the drivers and resolve all names; raises ConfigError with file, line and key.

    `seed` replaces the seed of every driver that has one.
    """
    drivers: dict[str, CyclicDriver] = {}
    chosen: dict[str, BaseModel] = {}
    first_input, first_output = {}, {}
    silent_ns = round(configuration.faults.link.silent_ms * 1e6)
    inputs = outputs = 0
    for name, entry in configuration.drivers.items():
        drivers[name], chosen[name] = build_driver(source, name, entry, configuration.loop.period_ns, silent_ns, seed)
        first_input[name], first_output[name] = inputs, outputs
        inputs += len(drivers[name].inputs)
        outputs += len(drivers[name].outputs)
    if inputs > MAX_SIGNALS or outputs > MAX_OUTPUTS:
        raise source.error(
            ("drivers",), f"{inputs} inputs and {outputs} outputs; at most {MAX_SIGNALS} and {MAX_OUTPUTS} fit"
        )
    derived = [] if configuration.frame is None else [f"deviation_{axis}" for axis in configuration.axes]
    if inputs + len(derived) > MAX_SIGNALS:
        raise source.error(("reference", "frame"), f"{inputs} inputs leave no room for its signals in {MAX_SIGNALS}")
    signal_index = {name: inputs + i for i, name in enumerate(derived)}
    output_index: dict[str, int] = {}
    for name, signal in configuration.signals.items():
        driver_name, channel = _channel(source, "signals", name, signal, drivers)
        signal_index[name] = first_input[driver_name] + channel
    for name, output in configuration.outputs.items():
        driver_name, channel = _channel(source, "outputs", name, output, drivers)
        index = first_output[driver_name] + channel
        if index in output_index.values():
            raise source.error(("outputs", name), "another output writes the same channel already")
        output_index[name] = index
    switch_index: dict[str, int] = {}
    for name in type(configuration.switches).model_fields:
        switch: Switch | None = getattr(configuration.switches, name)
        if switch is None:
            continue
        driver_name, channel = _channel(source, "switches", name, switch, drivers)
        index = first_output[driver_name] + channel
        if index in (*output_index.values(), *switch_index.values()):
            raise source.error(("switches", name), "another output writes the same channel already")
        switch_index[name] = index
    return Wiring(drivers, chosen, first_input, first_output, signal_index, output_index, switch_index)
