"""The reference in docs/ says what the models say."""

from pathlib import Path

from micromanip.settings.documents import drivers_page as drivers_doc
from micromanip.settings.documents.configuration_page import render

DOCUMENT = Path(__file__).parents[2] / "docs" / "configuration.md"


def test_reference_is_up_to_date():
    assert DOCUMENT.read_text() == render(), "run: make docs"


def test_drivers_options_are_up_to_date():
    page = DOCUMENT.with_name("driver-options.md")
    assert page.read_text() == drivers_doc.render(), (
        "run: python -m micromanip.settings.documents.drivers_page > docs/driver-options.md"
    )


def test_reference_names_unit_range_default_and_variants():
    text = render()
    assert "| `Ti_ms` | a number | milliseconds | required | from 0.001 to 3600000 | live | Integral time. |" in text
    assert (
        "| `rate_hz` | a whole number | hertz | `10000` | from 100 to 20000 | needs restart | Cycles a second. |"
        in text
    )
    assert "### `axes.<name>.hysteresis with model: network`" in text
    assert "\n### `reference.sines[i]`\n" in text
