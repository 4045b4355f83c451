"""The page on the control socket has every verb, its keys and who may ask for it, as the controller has them."""

import asyncio
import re
from pathlib import Path
from unittest.mock import AsyncMock, Mock

import pytest

from micromanip.errors import MicromanipError
from micromanip.host.control.authority import Peer
from micromanip.host.control.request import Request
from micromanip.host.control.verbs import Verbs

PAGE = (Path(__file__).resolve().parents[2] / "docs/tune.md").read_text(encoding="utf-8")
TABLE = PAGE.split("| verb | keys | who |")[1].split("\n\n")[0]
ROWS = [line.strip("| ").split(" | ") for line in TABLE.splitlines()[2:]]
NAME = re.compile(r"`(\w+)`")


def verbs():
    return Verbs(Mock(), AsyncMock(), Mock(), AsyncMock(), Mock(), Mock(), Mock(), Mock()).table()


def known(verb, given):
    """Keys that a verb names when it is handed one that it does not know."""
    with pytest.raises(MicromanipError, match="known here are") as refused:
        asyncio.run(verbs()[verb].act(Request(verb, given | {"unheard_of": 1}, Peer("ana"))))
    listed = re.search(r"known here are (.*)", str(refused.value))[1]
    return set() if listed == "none" else set(listed.split(", "))


def test_the_page_has_every_verb_once():
    told = [name for verb, *_ in ROWS for name in NAME.findall(verb)]
    assert sorted(told) == sorted(verbs())


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row[0])
def test_a_verb_takes_the_keys_and_the_right_that_the_page_says(row):
    names, keys, who = row
    for verb in NAME.findall(names):
        beginning, *later = keys.split("; then ")
        told = set() if beginning.startswith("none") else set(NAME.findall(beginning.split(": [")[0]))
        assert known(verb, {}) == told
        if later:
            assert known(verb, {"number": 1}) == set(NAME.findall(later[0]))
        assert verbs()[verb].right.name.lower() == who
