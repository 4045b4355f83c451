"""``micromanip check``: is this configuration good, and does it fit into a cycle?"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from .echo import echo
from .options import Answer, config_argument, subcommand, warn


@subcommand("check", "micromanip check config/simulated.yaml")
@config_argument
def command(config: Path) -> Answer:
    """Validate CONFIG and print its cycle budget; nothing is started, nothing moves.

    Exit code 78 with one line FILE:LINE: KEY: what is wrong, for each problem.
    """
    from micromanip.design.learning.memory import memory_warnings
    from micromanip.host.state_directory import memory_folder
    from micromanip.settings.check import prepare
    from micromanip.settings.checks.feedback import strain_loops
    from micromanip.settings.schema.model import ARMS_WITHIN_S
    from micromanip.settings.wiring.buses import budget as bus_budget
    from micromanip.virtual.cell import measured_cycle_ns

    prepared = prepare(config)
    configuration, wiring = prepared.configuration, prepared.wiring
    cycle_ns = measured_cycle_ns(prepared) if wiring.virtual else None
    loop = configuration.loop
    warnings = prepared.warnings
    if configuration.learning is not None:  # of a cell that runs, the learning process tells it
        warnings += memory_warnings(configuration, memory_folder(configuration.learning, prepared.source.path))
    report: dict[str, Any] = {
        "ok": True,
        "warnings": warnings,
        "sha256": prepared.source.hash,
        "rate_hz": loop.rate_hz,
        "period_us": loop.period_ns / 1e3,
        "spin_us": loop.spin_us,
        "cycle_us": round(cycle_ns / 1e3, 3) if cycle_ns else None,
        "share_percent": round(100 * cycle_ns / loop.period_ns, 2) if cycle_ns else None,
        "buses": {
            name: [
                {
                    "name": load.name,
                    "share_percent": round(100 * load.share, 1),
                    "limit_percent": round(100 * load.limit, 1),
                    "detail": load.detail,
                }
                for load in loads
            ]
            for name, loads in bus_budget(wiring).items()
        },
        "drivers": {
            name: {
                "driver": configuration.drivers[name].driver,
                "simulated": driver.simulated,
                "watchdog": driver.watchdog,
            }
            for name, driver in wiring.drivers.items()
        },
        "axes": {
            name: {
                "mode": axis.mode,
                "untuned": axis.untuned,
                "hysteresis": axis.hysteresis.model,
                "plays": len(getattr(axis.hysteresis, "weights", ())),
                "states": int(prepared.parameters[0]["axis"][i]["outer"]["states"]) if axis.mode == "stage" else 0,
            }
            for i, (name, axis) in enumerate(configuration.axes.items())
        },
    }
    if configuration.arm_on_start:
        report["arm_on_start"] = {"within_s": ARMS_WITHIN_S}
    for loop_found in strain_loops(configuration, wiring):
        report["axes"][loop_found.axis]["strain_loop"] = {
            "crossover_Hz": round(loop_found.crossover_Hz, 1),
            "phase_margin_deg": round(loop_found.phase_deg, 1),
            "slowest_path": loop_found.path,
            "slowest_path_ms": round(1e3 * loop_found.path_s, 3),
        }
    warn(warnings)
    return Answer(report, lambda: _print(report, config))


def _print(report: dict[str, Any], config: Path) -> None:
    echo(f"{config}: good")
    echo(f"  loop    {report['rate_hz']} Hz, period {report['period_us']:g} us, spins {report['spin_us']:g} us of it")
    if report["cycle_us"] is not None:
        echo(
            f"  cycle   {report['cycle_us']:.2f} us on this machine, simulated cell included: "
            f"{report['share_percent']:.1f} % of the period"
        )
    for name, axis in report["axes"].items():
        model = f"{axis['plays']} plays" if axis["plays"] else axis["hysteresis"]
        tuned = "untuned: open loop" if axis["untuned"] else f"hysteresis {model}, {axis['states']} estimator states"
        echo(f"  axis {name}  mode {axis['mode']}, {tuned}")
        if found := axis.get("strain_loop"):
            echo(
                f"    strain loop about {found['crossover_Hz']:.0f} Hz, {found['phase_margin_deg']:.0f} deg, over "
                f"{found['slowest_path']}: {found['slowest_path_ms']:.2g} ms"
            )
    if by_itself := report.get("arm_on_start"):
        within = f"READY, or within {by_itself['within_s']:g} s of it, once every sensor is valid"
        echo(f"  arms by itself as soon as {within}")
    for name, driver in report["drivers"].items():
        kind = "simulated" if driver["simulated"] else f"real; watchdog: {driver['watchdog'] or 'NONE'}"
        echo(f"  driver {name}: {driver['driver']}, {kind}")
        for load in report["buses"].get(name, ()):
            echo(f"    {load['name']} {load['share_percent']:.0f} % of {load['limit_percent']:.0f} %: {load['detail']}")
