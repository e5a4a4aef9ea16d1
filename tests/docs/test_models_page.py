"""docs/models.md says what the code says."""

from __future__ import annotations

import json

from fitter.spec import OPTIONS
from tests.docs import models_page


def test_the_page_is_what_its_generator_makes() -> None:
    """Names, reciprocity, options, parameters and words are the code's; figures are the committed ones."""
    document = json.loads(models_page.FIGURES.read_text())
    missing = {spec.name for spec in models_page.specs()} ^ {model["name"] for model in document["models"]}
    assert not missing, f"run python -m tests.docs.models_page --measure {' '.join(sorted(missing))}"
    assert models_page.PAGE.read_text() == models_page.page(document), "run python -m tests.docs.models_page"


def test_every_family_has_its_section() -> None:
    text = models_page.PAGE.read_text()
    assert not [family for family in OPTIONS if f"\n## {family}\n" not in text]
