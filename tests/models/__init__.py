"""Every model the suite runs over: adding a model adds its short names here."""

MODELS = (
    "ward",
    "ward:duer",
    "ward:bounded",
    "ward:no_diffuse",
    "torrance_sparrow",
    "torrance_sparrow:smith",
    "torrance_sparrow:ggx:smith",
    "torrance_sparrow:ggx:none",
    "lafortune",
    "lafortune:2",
    "lafortune:3:no_diffuse",
    "oren_nayar",
)
