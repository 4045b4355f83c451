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
