"""Which models are tried: every name can be fitted, and what is left out says why."""

from __future__ import annotations

import pytest

from fitter.fitting import check
from fitter.selection import candidates
from fitter.spec import FitSpec, ModelSpec

EVERY = (
    *candidates.PLAIN, *candidates.FORMS, *candidates.SPECIAL, *candidates.ANISOTROPIC, candidates.THREE_LOBES
)  # fmt: skip


@pytest.mark.parametrize("name", EVERY)
def test_every_candidate_is_a_model_that_can_be_fitted(name):
    check(FitSpec(model=ModelSpec.parse(name)))
    assert ModelSpec.parse(name).name == name


def named(errors, azimuths=1):
    """What the stages after the first try, and what they skip, with these errors of all that is tried."""
    tried, skipped = {}, {}
    for stage in candidates.stages(azimuths):
        names, left = stage(tried)
        tried |= {name: errors.get(name, 9.0) for name in names}
        skipped |= {one.model: one.reason for one in left}
    assert not set(tried) & set(skipped)
    assert set(tried) | set(skipped) == set(EVERY)
    return set(tried), skipped


def test_a_diffuse_table_tries_the_diffuse_forms_only():
    tried, skipped = named({"lambert": 1.02, "oren_nayar": 1.0})
    assert tried - set(candidates.PLAIN) == {"oren_nayar:full"}
    assert "9 times the smallest" in skipped["torrance_sparrow:ggx"]
    assert "two lobes is 9 times" in skipped["lafortune:3"] or "second lobe" in skipped["lafortune:3"]


def test_a_glossy_table_tries_the_forms_of_microfacets():
    tried, skipped = named({"torrance_sparrow": 1.2, "torrance_sparrow:ggx:smith": 1.0})
    assert {"torrance_sparrow:smith", "torrance_sparrow:ggx", "torrance_sparrow:none"} <= tried
    assert "one incident azimuth" in skipped["ward:anisotropic"]


def test_azimuths_make_anisotropic_forms_candidates():
    tried, skipped = named({"ward": 1.0, "ward:bounded": 1.1}, azimuths=3)
    assert {"ward:anisotropic", "ward:bounded:anisotropic"} <= tried
    assert "lafortune:anisotropic" in skipped


@pytest.mark.parametrize(
    ("errors", "tried"),
    [
        ({"lafortune": 2.0, "lafortune:2": 1.0}, True),
        ({"lafortune": 1.0, "lafortune:2": 0.995}, False),  # the second lobe does nothing
        ({"ward": 0.1, "lafortune": 2.0, "lafortune:2": 1.0}, False),  # a third one can't make up for it
        ({"lafortune": 1.0, "lafortune:2": None}, False),  # the table does not determine two
    ],
)
def test_a_third_lobe_is_tried_where_it_may_pay(errors, tried):
    found, skipped = named(errors)
    assert ("lafortune:3" in found) is tried
    assert ("lafortune:3" in skipped) is not tried
