"""The page of all faults in Markdown, generated from their messages.

``python -m micromanip.host.faults_page > docs/faults.md`` writes it; a test compares the two.
"""

from __future__ import annotations

import sys

from .messages import ALL, FaultText

_INTRODUCTION = """\
# Faults

Generated from `micromanip/host/faults.toml` by `python -m micromanip.host.faults_page`; edit the texts there.

A fault stays latched until `micromanip reset`, and nothing arms itself again. Every trip leaves a black box:
`micromanip explain` reads the newest one and says in which order things happened. `<value>` is what was measured,
`<limit>` what it was held against.
"""


def render() -> str:
    """The whole page, in the order of the codes."""
    return "\n".join([_INTRODUCTION, *(_section(text) for text in sorted(ALL, key=lambda text: text.code))])


def _section(text: FaultText) -> str:
    causes = "".join(f"\n- {cause}" for cause in text.likely_causes)
    return f"""\
## {text.code}: {_seen(text.what)}

**Detection**: {text.detection}

**Reaction**: {text.reaction}

**Likely causes**:
{causes}

**Next step**: {text.next_step}
"""


class _Placeholder(str):
    """Stands for a number in a format string, whatever its format."""

    __slots__ = ()

    def __format__(self, _specification: str) -> str:
        return str(self)


def _seen(what: str) -> str:
    names = {"value": "`<value>`", "limit": "`<limit>`", "how": "died"}
    return what.format(**{name: _Placeholder(shown) for name, shown in names.items()})


if __name__ == "__main__":
    sys.stdout.write(render())
