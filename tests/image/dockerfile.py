"""The Dockerfile, as far as this project's needs it: what is not understood is an error, not left out."""

from __future__ import annotations

import json
import re
import shlex
from dataclasses import dataclass, field
from pathlib import Path

KNOWN = ("RUN", "COPY", "USER", "WORKDIR", "ENV", "VOLUME", "EXPOSE", "HEALTHCHECK", "CMD")


@dataclass(frozen=True)
class Step:
    """An instruction of ``KNOWN`` and what stands behind it."""

    instruction: str
    text: str


@dataclass(frozen=True)
class Stage:
    """What one FROM begins; ``name`` is that of AS, or its position."""

    name: str
    base: str
    steps: list[Step] = field(default_factory=list[Step])

    def last(self, instruction: str) -> str | None:
        """What the last such instruction says."""
        found = [step.text for step in self.steps if step.instruction == instruction]
        return found[-1] if found else None


@dataclass(frozen=True)
class Copy:
    """COPY: ``source`` names a stage, or is None for the project's folder."""

    sources: tuple[str, ...]
    target: str
    source: str | None


def stages(path: Path) -> list[Stage]:
    """Raises ValueError on an instruction or an option that isn't known."""
    lines = [line for line in path.read_text().splitlines() if not line.lstrip().startswith("#")]
    whole = re.sub(r"\\\n\s*", "", "\n".join(lines))
    found: list[Stage] = []
    for line in filter(None, map(str.strip, whole.splitlines())):
        instruction, _, text = line.partition(" ")
        if instruction == "FROM":
            base, *rest = text.split()
            if rest and (rest[0] != "AS" or len(rest) != 2):
                raise ValueError(f"not understood: {line}")
            found.append(Stage(rest[1] if rest else str(len(found)), base))
        elif instruction in KNOWN and found:
            found[-1].steps.append(Step(instruction, text.strip()))
        else:
            raise ValueError(f"not understood: {line}")
    return found


def copied(text: str) -> Copy:
    """What a COPY says."""
    words = shlex.split(text)
    options = [word for word in words if word.startswith("--")]
    *sources, target = words[len(options) :]
    if len(options) > 1 or any(not option.startswith("--from=") for option in options):
        raise ValueError(f"not understood: COPY {text}")
    return Copy(tuple(sources), target, options[0].removeprefix("--from=") if options else None)


def words(text: str) -> list[str]:
    """A command in the form of a JSON list, which CMD and HEALTHCHECK have to have."""
    found = json.loads(text[text.index("[") :])
    if not isinstance(found, list):
        raise ValueError(f"not understood: {text}")
    return [str(word) for word in found]  # pyright: ignore[reportUnknownVariableType, reportUnknownArgumentType]
