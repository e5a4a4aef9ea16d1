"""What of a scene's light is left out: lamps that add nothing, shadows, reflections between shapes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from fitter.scene import effects, occlusion, wording
from fitter.scene.boxes import Boxes
from fitter.scene.criteria import Criteria
from fitter.scene.materials import ModelMaterial
from fitter.scene.search import Decision

#: Of a lamp whether nothing can stand before it, the boxes that took, points where something does.
Proof = tuple[bool, int, Boxes]


def dark(criteria: Criteria, tolerance: float) -> tuple[set[int], float, list[dict[str, Any]]]:
    """Lamps that add nothing visible: as many as have bounds that together are within half the tolerance (the
    other half is for the materials), their bound, and decisions."""
    lamps, bounds = criteria.scene.lamps, dict[int, Decision]()
    for k in criteria.lamps if len(lamps) > 1 else ():
        others = [j for j in criteria.lamps if j != k and criteria.clear[j] and lamps[j].is_delta]
        found = _lamp(criteria, k, others, tolerance)
        if found is not None:
            bounds[k] = found
    best: list[int] = []
    usable = [k for k, found in bounds.items() if found.state == "bounded"]
    # As many as there can be: the faintest first. One is left at least.
    for k in sorted(usable, key=lambda k: bounds[k].bound)[: len(lamps) - 1]:
        if sum(bounds[j].bound for j in (*best, k)) <= 0.5 * tolerance:
            best.append(k)
    decisions: list[dict[str, Any]] = []
    for k, found in bounds.items():
        gone = k in best
        sentence = f"light {k} ({lamps[k].kind}) " + (
            f"off where the camera looks: error <= {100 * found.bound:.2g} %" if gone
            else f"kept: {wording.reason(found)}"
        )  # fmt: skip
        decisions.append(wording.decision("light", str(k), found, gone, sentence))
    return set(best), sum(bounds[k].bound for k in best), decisions


def _lamp(criteria: Criteria, k: int, others: Sequence[int], tolerance: float) -> Decision | None:
    """How much light k adds, beside that of ``others``, which nothing shades, and over 0.01 F at least."""
    if criteria.scene.lamps[k].kind == "environment" or criteria.floor == 0:
        return None
    worst: Decision | None = None
    for m, one in enumerate(criteria.scene.materials):
        if not isinstance(one, ModelMaterial) or (effects.unbounded(one.model) is not None):
            return None
        found = criteria.dark(k, tuple(others), m, one, tolerance)
        if found.state != "bounded":
            return found
        if worst is None or found.bound > worst.bound:
            worst = found
    return worst


def shadow(criteria: Criteria, k: int, proof: Proof, tolerance: float) -> tuple[bool, dict[str, Any]]:
    """Whether rays to lamp k have to be tried, and the decision."""
    clear, boxes, witness = proof
    name = f"shadows of light {k} ({criteria.scene.lamps[k].kind})"
    if clear:
        found = Decision("bounded", 0.0, 0.0, boxes)
        sentence = f"{name} off: nothing can stand between it and any surface, error 0"
        return False, wording.decision("shadows", str(k), found, True, sentence)
    error = criteria.hidden(k, witness, tolerance)
    if error <= tolerance and len(witness):
        sentence = f"{name} kept: what they change is not bounded"
        return True, {**wording.kept(str(k), "shadows", sentence), "found": error, "boxes": boxes}
    found = Decision("needed" if error > tolerance else "open", float("inf"), error, boxes)
    sentence = f"{name} kept: {wording.reason(found)}"
    return True, wording.decision("shadows", str(k), found, False, sentence)


def bounces(criteria: Criteria) -> tuple[int, list[dict[str, Any]]]:
    """Reflections between shapes, none where no surface sees another, and the decision."""
    scene = criteria.scene
    if scene.spec.bounces == 0:
        return 0, []
    if any(one.transmits for one in scene.materials) or not occlusion.nothing_faces(criteria.surfaces):
        sentence = "reflections between shapes kept: surfaces face each other"
        return scene.spec.bounces, [wording.kept("all", "bounces", sentence)]
    sentence = "reflections between shapes off: no surface faces another, error 0"
    return 0, [wording.decision("bounces", "all", Decision("bounded", 0.0, 0.0, 0), True, sentence)]
