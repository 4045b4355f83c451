"""What loggers, oscilloscopes and meters write: the same numbers come out of each, and what was mended is told."""

import json
import re

import numpy as np
import pytest

from micromanip.errors import CheckFailed
from micromanip.recordings import Wanted, take

from .signals import SAMPLES, T, U, lines
from .test_text import same, split, written

ROWS = lines(digits=12)


def shown(rows, *header):
    return "\n".join([*(header or ["t,u,y"]), *rows]) + "\n"


def timed(form):
    """The rows, with their times in s written by `form`."""
    return [f"{form(float(t))},{u},{y}" for t, u, y in map(split, ROWS)]


def of_day(t, begin=86398.0, half=False):
    minutes, seconds = divmod(round((begin + t) % 86400.0, 6), 60.0)
    hours = int(minutes) // 60
    return f"{(hours + 11) % 12 + 1 if half else hours:02d}:{int(minutes) % 60:02d}:{seconds:06.3f}"


def but(places, form):
    """The rows, of which those at `places` have `form` of the true y."""
    return [f"{t},{u},{form(float(y)) if k in places else y}" for k, (t, u, y) in enumerate(map(split, ROWS))]


BESIDE = ["Record Length,600,", "Sample Interval,0.005,", "Source,CH1,", "Firmware,FV:v24,"]
PACKET = ["Channels\t2", "Samples\t300\t300", "***End_of_Header***\t", "X_Value\tu\ty"]
READ = {  # text, columns and options, what is told
    "fortran": (shown([r.replace(",", "D0 ") for r in ROWS], "t u y"), {}, ""),
    "a true minus": (shown([r.replace("-", "\N{MINUS SIGN}") for r in ROWS]), {}, ""),
    "types below the units": (shown(ROWS, "t,u,y", "s,V,um", "float,float32,double"), {}, ""),
    "names of values in the header": (
        shown([f"{r}," for r in ROWS], "t,u,y,Start,Increment,", "second,Volt,um,-2.0,5e-3"), {}, "",
    ),
    "settings beside the rows": (
        "\n".join(f"{BESIDE[k] if k < len(BESIDE) else ',,'},{row}" for k, row in enumerate(ROWS)),
        {"columns": ("5", "6"), "time": "4:s"}, "",
    ),
    "dates that say two things": (
        shown(timed(lambda t: "11/12/2026 " + of_day(t))), {}, "t begins anew at x:402: counted on from 86400",
    ),
    "half days": (
        shown(timed(lambda t: f"12-Nov-2026 {of_day(t, 43198.0, half=True)} {'PM' if t >= 2.0 else 'AM'}")), {}, "",
    ),
    "minutes": (shown(timed(lambda t: f"59:{10.0 + t:06.3f}")), {}, ""),
    "thousandths": (shown(timed(lambda t: f"10:00:{10.0 + t:06.3f}".replace(".", ":"))), {}, ""),
    "seconds of the day": (
        shown(timed(lambda t: (86398.0 + t) % 86400.0), "t_s,u,y"), {},
        "t_s begins anew at x:402: counted on from 86400",
    ),
    "a counter of eight bits": (
        shown(timed(lambda t: round(t / 5e-3) % 256)), {"time": "t:samples", "step_s": 5e-3},
        "t begins anew, 2 times, first at x:258: counted on from 256",
    ),
    "microseconds of 32 bits": (
        shown(timed(lambda t: (2**32 - 999_000 + round(1e6 * t)) % 2**32), "micros,u,y"), {},
        "micros begins anew at x:202: counted on from 4294967296",
    ),
    "days of a spreadsheet": (shown(timed(lambda t: f"{46000.5 + t / 86400.0:.12f}")), {"time": "t:days"}, ""),
    "remarks": (
        shown([*ROWS[:300], "# coolant on", *ROWS[300:]]), {},
        "line 302: '# coolant on' between rows that go on evenly behind it, left out",
    ),
    "a header on each page": (
        shown([*ROWS[:200], "t,u,y", *ROWS[200:400], "t,u,y", *ROWS[400:]]), {},
        "line 202: 't,u,y' between rows that go on evenly behind it, and 1 line more, left out",
    ),
    "packets": (
        shown([*ROWS[:300], *PACKET, *ROWS[300:]], "LabVIEW Measurement", *PACKET).replace(",", "\t"), {},
        "line 306: 'Channels\\t2' between rows that go on evenly behind it, and 3 lines more, left out",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", READ)
def test_what_a_logger_writes_is_read(name, tmp_path):
    text, options, told = READ[name]
    taken = same(written(tmp_path / "x", text), **options)
    assert "; ".join(taken.notes).replace(f"{tmp_path}/", "") == told


@pytest.mark.parametrize(
    "none",
    ["1.#INF", "-1.#IND00", "1.#QNAN", "(null)", "NULL", "#N/A", "#DIV/0!", "---", "?", "\N{INFINITY}", "OL", "OVER"],
)
def test_what_stands_for_no_number_is_left_out(none, tmp_path):
    taken = take(written(tmp_path / "x", shown(but({300, 301}, lambda _: none))), Wanted(("u", "y")))
    assert taken.notes[0].startswith(f"2 rows lack a number and are left out, the first at {tmp_path}/x:302")
    assert len(taken.values) == SAMPLES - 2


@pytest.mark.parametrize("none", [-999, -9999, 9.91e37, 99999])
def test_nines_far_from_all_others_are_none_unless_spikes_are_kept(none, tmp_path):
    file = written(tmp_path / "x", shown(but({300, 301}, lambda _: none)))
    taken = take(file, Wanted(("u", "y")))
    assert (
        f"y has {none:g} in 2 rows, the first at {file}:302, far from all others: taken as no number" in taken.notes[0]
    )
    assert taken.values.max() < 200.0
    assert np.abs(take(file, Wanted(("u", "y"), bridge=False)).values).max() == abs(none)
    blow = written(tmp_path / "blow", shown(but({300, 301, 302, 303}, lambda _: 999)))
    assert take(blow, Wanted(("u", "y"))).values[302, 1] == 999.0


TWICE = [*ROWS[:300], *ROWS[:300]]
REFUSED = {
    "run 2": (shown([*ROWS[:300], "# run 2", *ROWS[:300]]), "x:302: a second table begins here"),
    "days": (
        shown(timed(lambda t: f"{46000.5 + t / 86400.0:.12f}")),
        r"x:2: t is 46000.5 .* --time 't:days', else 't:s'",
    ),
    "a clock that was set": (shown(timed(lambda t: t - 0.35 * (t > 2.0))), r"x:403: t falls by 0.345 s here"),
    "a word that falls": (
        shown(timed(lambda t: t % 1.0), "sampling_time,u,y"),
        "x:202: sampling_time falls by 0.995 s",
    ),
    "JSON": (json.dumps({"t": T.tolist(), "u": U.tolist()}), r"x: this is JSON: save its columns as CSV"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_says_two_things_is_refused_with_its_line(name, tmp_path):
    text, sentence = REFUSED[name]
    with pytest.raises(CheckFailed, match=sentence):
        take(written(tmp_path / "x", text), Wanted(("amp.u" if text[0] == "{" else "u", "y")))


def test_of_thousands_of_columns_a_hundred_are_listed(tmp_path):
    wide = "\n".join(",".join(f"{row + 0.5 * k:g}" for k in range(3000)) for row in range(20))
    with pytest.raises(CheckFailed) as raised:
        take(written(tmp_path / "x", wide), Wanted(("u", "y"), step_s=1.0))
    assert re.search(r"its columns are 1, 2, .*, 100, 2900 more$", str(raised.value))
