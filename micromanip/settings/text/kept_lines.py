"""What was changed in a text, brought into the same text as somebody else wrote it: a three-way merge of lines.

Khanna, Kunal and Pierce, "A Formal Investigation of Diff3", FSTTCS 2007: what lies between lines that all three have
is somebody's own where the program changed nothing there, else the program's.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from difflib import SequenceMatcher


def with_lines_kept(own: str, before: str, after: str) -> str:
    """`own` with what `after` has changed of `before`, which says the same as `own` in other lines."""
    texts = tuple(text.splitlines(keepends=True) for text in (own, before, after))
    result: list[str] = []
    ends = (0, 0, 0)
    for starts, count in _in_all(*texts):
        mine, old, new = (text[end:start] for text, end, start in zip(texts, ends, starts, strict=True))
        result += mine if new == old else new
        result += texts[0][starts[0] : starts[0] + count]
        ends = (starts[0] + count, starts[1] + count, starts[2] + count)
    return "".join(result)


def _in_all(
    own: Sequence[str], before: Sequence[str], after: Sequence[str]
) -> Iterator[tuple[tuple[int, int, int], int]]:
    """Where runs of lines that are in all three begin in each, and how long they are; an empty one at their ends."""
    to_own = _blocks(before, own)
    to_after = _blocks(before, after)
    i = k = 0
    while i < len(to_own) and k < len(to_after):
        (in_before, in_own, size), (there, in_after, there_size) = to_own[i], to_after[k]
        first, last = max(in_before, there), min(in_before + size, there + there_size)
        if first < last:
            yield (in_own + first - in_before, first, in_after + first - there), last - first
        if in_before + size < there + there_size:
            i += 1
        else:
            k += 1
    yield (len(own), len(before), len(after)), 0


def _blocks(a: Sequence[str], b: Sequence[str]) -> Sequence[tuple[int, int, int]]:
    return SequenceMatcher(None, a, b, autojunk=False).get_matching_blocks()
