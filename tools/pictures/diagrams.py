"""The block diagrams of the documentation: boxes and arrows at given places, drawn by matplotlib."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from matplotlib.figure import Figure
from matplotlib.patches import Circle, FancyBboxPatch

Point = tuple[float, float]

INK, GREY = "#222222", "#777777"
CONTROLLER, PLANT, MEMORY, OUTSIDE = "#dbe9f6", "#fde3c8", "#e4f0dc", "#f2f2f2"


class Sheet:
    """A drawing area of `width` x `height` units, ten units an inch, origin at the lower left."""

    def __init__(self, width: float, height: float) -> None:
        self.figure = Figure(figsize=(width / 10, height / 10))
        self._axes = self.figure.add_axes((0, 0, 1, 1))
        self._axes.set(xlim=(0, width), ylim=(0, height))
        self._axes.axis("off")

    def box(self, x: float, y: float, width: float, height: float, text: str, colour: str = CONTROLLER) -> None:
        """A box centred at (x, y)."""
        style = "round,pad=0,rounding_size=0.6"
        corner = (x - width / 2, y - height / 2)
        self._axes.add_patch(FancyBboxPatch(corner, width, height, boxstyle=style, fc=colour, ec=INK, lw=0.9))
        self.text(x, y, text)

    def frame(self, left: float, low: float, right: float, high: float, title: str) -> None:
        """A dashed frame around a group, its title inside at the upper left."""
        style = "round,pad=0,rounding_size=0.8"
        patch = FancyBboxPatch(
            (left, low), right - left, high - low, boxstyle=style, fc="none", ec=GREY, lw=0.9, ls="--"
        )
        self._axes.add_patch(patch)
        self.text(left + 1, high - 1.6, title, "left", GREY)

    def sum(self, x: float, y: float) -> None:
        """A summing point."""
        self._axes.add_patch(Circle((x, y), 1.1, fc="white", ec=INK, lw=0.9))
        self.text(x, y, "+")

    def text(self, x: float, y: float, text: str, align: str = "center", colour: str = INK, size: float = 8.5) -> None:
        """Text at (x, y), centred upright."""
        self._axes.text(x, y, text, ha=align, va="center", color=colour, fontsize=size, linespacing=1.25)

    def arrow(self, *points: Point, both: bool = False, colour: str = INK) -> None:
        """A line through `points` with a head at its end, or at both ends."""
        xs, ys = zip(*points, strict=True)
        self._axes.plot(xs, ys, color=colour, lw=1.0, solid_joinstyle="miter", solid_capstyle="butt")
        ends: Sequence[tuple[Point, Point]] = [(points[-2], points[-1])]
        if both:
            ends = [*ends, (points[1], points[0])]
        for tail, tip in ends:
            head = {"arrowstyle": "-|>", "color": colour, "lw": 0, "shrinkA": 0, "shrinkB": 0, "mutation_scale": 10}
            self._axes.annotate("", tip, tail, arrowprops=head)


def machining_cell() -> Figure:
    """What is where in the cell, and what the controller does in each period of 100 us."""
    s = Sheet(92, 44)
    s.frame(24, 15, 90, 42.5, "controller, 10 000 times a second")
    s.box(36, 34, 19, 8, "where should the\nspindle be now?\n(predictor)")
    s.box(36, 21.5, 19, 8, "where is it, what\npushes it?\n(Kalman filter)")
    s.box(57.5, 34, 14, 8, "actuator\nset-point\n(LQG)")
    s.box(78.5, 34, 19, 8, "piezo voltage:\ninverse hysteresis\n+ PID")
    s.box(78.5, 21.5, 19, 6, "limiter: the last gate")
    s.box(11, 34, 18, 8, "laser tracker:\npath deviation\nof the robot", OUTSIDE)
    s.box(11, 6, 18, 8, "robot with the\nworkpiece", OUTSIDE)
    s.box(36, 6, 19, 8, "spindle on its stage,\ncapacitive sensor", PLANT)
    s.box(57.5, 6, 14, 8, "lever and\nflexure x5", PLANT)
    s.box(78.5, 6, 19, 8, "amplifier, piezo,\nstrain gauge", PLANT)
    s.arrow((20, 34), (26.5, 34))
    s.arrow((45.5, 34), (50.5, 34))
    s.arrow((64.5, 34), (69, 34))
    s.arrow((78.5, 30), (78.5, 24.5))
    s.arrow((78.5, 18.5), (78.5, 10))
    s.text(79.2, 13, "-20..150 V", "left", GREY)
    s.arrow((69, 6), (64.5, 6))
    s.arrow((50.5, 6), (45.5, 6))
    s.arrow((26.5, 6), (20, 6), both=True)
    s.text(23.2, 8.6, "cutting\nforce", "center", GREY, 7.5)
    s.arrow((11, 10), (11, 30))
    s.arrow((36, 10), (36, 17.5))
    s.text(36.7, 13, "stage position", "left", GREY)
    s.arrow((45.5, 21.5), (57.5, 21.5), (57.5, 30))
    s.arrow((84.5, 10), (84.5, 12), (67, 12), (67, 31.5), (69, 31.5))
    s.text(66.4, 13.4, "strain", "right", GREY)
    return s.figure


def control_scheme() -> Figure:
    """The control law of one axis, as the code names its parts."""
    s = Sheet(118, 48)
    s.box(11, 38, 18, 7, "reference predictor\nreference.py")
    s.box(29, 38, 9, 6, "$G$\nlqg.py")
    s.sum(40, 38)
    s.box(52, 38, 14, 7, "range and slew of\nthe set-point\nsetpoint_history.py")
    s.box(78, 43, 16, 6, "inverse (7)-(9)\nfeedforward.py")
    s.sum(68, 33)
    s.box(78, 33, 12, 6, "PID (17)\npid.py")
    s.sum(91, 38)
    s.box(101, 38, 10, 6, "limiter\nsaturation.py")
    s.box(40, 24, 9, 6, "$K$\nlqg.py")
    s.box(22, 14, 24, 9, "Kalman filter, each\nsample at its own age\nestimator.py")
    s.box(106, 23, 20, 7, "amplifier, piezo stack:\nhysteresis, creep", PLANT)
    s.box(106, 9, 20, 7, "lever, flexure, stage,\nspindle", PLANT)
    s.arrow((11, 47), (11, 41.5))
    s.text(12, 45.4, "path deviation (tracker)", "left", GREY, 7.5)
    s.arrow((20, 38), (24.5, 38))
    s.text(22.2, 39.4, "$w$", "center", GREY)
    s.arrow((33.5, 38), (38.9, 38))
    s.arrow((41.1, 38), (45, 38))
    s.text(43, 39.4, "$u$", "center", GREY)
    s.arrow((59, 38), (63, 38), (63, 43), (70, 43))
    s.arrow((63, 38), (63, 33), (66.9, 33))
    s.arrow((63, 33), (63, 12), (34, 12))
    s.text(62.3, 13.3, "set-point as given", "right", GREY, 7.5)
    s.arrow((69.1, 33), (72, 33))
    s.text(70.5, 34.3, "$e$", "center", GREY)
    s.arrow((86, 43), (91, 43), (91, 39.1))
    s.arrow((84, 33), (91, 33), (91, 36.9))
    s.arrow((92.1, 38), (96, 38))
    s.arrow((101, 35), (101, 28.4), (78, 28.4), (78, 30))
    s.text(90, 27.1, "anti-windup", "center", GREY, 7.5)
    s.arrow((106, 38), (111, 38), (111, 26.5))
    s.text(112, 32, "$v$", "left", GREY)
    s.arrow((96, 23), (68, 23), (68, 31.9))
    s.text(69.3, 31, "-", "left")
    s.text(82, 21.7, "strain gauge", "center", GREY, 7.5)
    s.arrow((106, 19.5), (106, 12.5))
    s.arrow((96, 7.5), (22, 7.5), (22, 9.5))
    s.text(80, 8.8, "capacitive sensor", "center", GREY, 7.5)
    s.arrow((106, 1.5), (106, 5.5))
    s.text(107, 3, "cutting force", "left", GREY, 7.5)
    s.arrow((34, 15), (40, 15), (40, 21))
    s.text(41.2, 17.5, r"$\hat{x}$", "left", GREY)
    s.arrow((40, 27), (40, 36.9))
    s.text(41.3, 36, "-", "left")
    return s.figure


def network() -> Figure:
    """The recurrent network as the inverse: displacement in, voltage out, the last turning point as memory."""
    s = Sheet(84, 42)
    for y, name in ((33, "$y_k$"), (23, "$y_m$"), (13, "$v_m$")):
        s.box(8, y, 9, 6, name, OUTSIDE)
    neurons = ((35, 37, "1"), (35, 28, "2"), (35, 9, "M"))
    for x, y, name in neurons:
        s.box(x, y, 13, 6, rf"$\sigma(\cdot)$  {name}")
        for source in (33, 23, 13):
            s.arrow((12.5, source), (28.5, y), colour="#9ab4cc")
    s.text(35, 18.5, "...", size=14)
    s.sum(56, 23)
    for _, y, _ in neurons:
        s.arrow((41.5, y), (54.9, 23.0 + 0.03 * (y - 23)), colour="#9ab4cc")
    s.text(20, 39.5, "$w^{(1)}, b^{(1)}$", "center", GREY)
    s.text(49.5, 35, "$w^{(2)}$", "center", GREY)
    s.arrow((56, 31), (56, 24.1))
    s.text(56, 32.4, "$b^{(2)}$", "center", GREY)
    s.arrow((57.1, 23), (77, 23))
    s.text(78, 23, "$v_k$", "left")
    s.box(62, 3.5, 30, 5, "memory: moves when\n$y$ turns back", MEMORY)
    s.arrow((68, 23), (68, 6))
    s.arrow((47, 3.5), (1.5, 3.5), (1.5, 13), (3.5, 13))
    s.arrow((1.5, 13), (1.5, 23), (3.5, 23))
    s.text(24, 2.1, "the pair of the last turning point", "center", GREY, 7.5)
    return s.figure


def processes() -> Figure:
    """Processes, the memory they share, and who writes what."""
    s = Sheet(108, 54)
    s.box(17, 42, 28, 10, "host process\nconfiguration, heartbeat,\ncontrol socket, live line")
    s.box(17, 16, 28, 14, "loop process\ncompiled, FIFO, pinned,\nmemory locked, 10 kHz;\ncalls the drivers")
    s.box(93, 10, 26, 7, "recorder process\nring to HDF5 file")
    s.box(93, 42, 26, 7, "status, arm, disarm, reset;\nclient.py", OUTSIDE)
    s.box(17, 2.7, 28, 4, "hardware, or the simulated cell", PLANT)
    s.frame(41, 5.5, 74, 52, "shared memory (memfd)")
    for y, name, what in (
        (44, "control", "heartbeat, command,\nparameter slots"),
        (35.25, "status", "state, signals,\nhistograms, snapshot"),
        (26.5, "contexts", "what the drivers know\nand remember"),
        (17.75, "samples", "a reference that was\nread from a file"),
        (9.75, "ring", "32 768 rows of telemetry"),
    ):
        s.box(57.5, y, 29, 7.2 if name != "ring" else 5.6, f"{name}\n{what}", MEMORY)
    s.arrow((31, 44), (43, 44))
    s.arrow((43, 36), (39.5, 36), (39.5, 40), (31, 40))
    s.arrow((43, 42.5), (33.5, 42.5), (33.5, 21), (31, 21))
    s.arrow((31, 19), (35.5, 19), (35.5, 34), (43, 34))
    s.arrow((31, 17), (37.5, 17), (37.5, 26.5), (43, 26.5), both=True)
    s.arrow((43, 17.75), (39.5, 17.75), (39.5, 14.5), (31, 14.5))
    s.arrow((31, 10), (43, 10))
    s.arrow((72, 10), (80, 10))
    s.arrow((17, 9), (17, 4.7), both=True)
    s.arrow((80, 42), (77, 42), (77, 53), (17, 53), (17, 47), both=True)
    s.text(78, 48, "Unix socket, JSON lines", "left", GREY, 7.5)
    return s.figure


def states() -> Figure:
    """The cell's states, and what leads from one to the next."""
    s = Sheet(104, 40)
    places = {
        "STARTING": (10, 33),
        "READY": (32, 33),
        "ARMING": (58, 33),
        "TRACKING": (90, 33),
        "HOLDING": (90, 19),
        "RAMPING": (64, 12),
        "FAULT": (32, 12),
        "OFF": (10, 12),
    }
    for name, (x, y) in places.items():
        s.box(x, y, 14, 6, name, "#f9d9d9" if name == "FAULT" else CONTROLLER)
    labels = (
        (21, 34.4, "sensors\nheard", "center"),
        (45, 34.4, "arm", "center"),
        (74, 34.4, "check, lift, sweep,\nsettle, authority", "center"),
        (93.5, 25.5, "hold,\nfault", "left"),
        (75, 22.6, "arm: goes on", "center"),
        (76, 27.1, "disarm, stop, fault", "center"),
        (72, 7.2, "disarm, stop; after a fault:\nretracted, or time", "left"),
        (57.3, 18.5, "disarm,\nstop, fault", "right"),
        (48, 10, "after a fault", "center"),
        (46.7, 21, "after\ndisarm", "left"),
        (48, 7.0, "after stop, or when the host is dead", "center"),
        (33, 25.5, "reset", "left"),
        (29.8, 22.5, "fault", "right"),
        (21, 13.4, "stop", "center"),
        (17.5, 25.8, "stop", "center"),
        (61, 2.6, "emergency stop, amplifier fault: from anywhere, at once", "left"),
    )
    for x, y, text, align in labels:
        s.text(x, y, text, align, GREY, 7.5)
    s.arrow((17, 33), (25, 33))
    s.arrow((39, 33), (51, 33))
    s.arrow((65, 33), (83, 33))
    s.arrow((92, 30), (92, 22))
    s.arrow((83, 21.5), (61.5, 21.5), (61.5, 30))
    s.arrow((90, 16), (90, 11), (71, 11))
    s.arrow((58, 30), (58, 15))
    s.arrow((86, 30), (86, 26), (66, 26), (66, 15))
    s.arrow((57, 12), (39, 12))
    s.arrow((57, 14), (46, 14), (46, 31.5), (39, 31.5))
    s.arrow((64, 9), (64, 6), (10, 6), (10, 9))
    s.arrow((36, 15), (36, 30))
    s.arrow((31, 30), (31, 15))
    s.arrow((25, 12), (17, 12))
    s.arrow((27, 30), (27, 24.5), (10, 24.5), (10, 15))
    s.arrow((60, 3), (33, 3), (33, 9))
    return s.figure


DIAGRAMS: dict[str, Callable[[], Figure]] = {
    "loop": machining_cell,
    "control_scheme": control_scheme,
    "network": network,
    "processes": processes,
    "states": states,
}
