"""A Sphinx extension: this project's docstrings as reStructuredText, and references that have to exist.

The docstrings describe arguments, fields and errors as ``name : what it is``, continued on indented lines,
under underlined headings or none. Here each becomes an item of a list. A reference to something that is on no
page stays plain text, but has to be importable: what is not is a warning, and so an error of the build.
"""

from __future__ import annotations

import importlib
import re
from typing import Any

from docutils import nodes
from sphinx.application import Sphinx

ITEM = re.compile(r"^(\*{0,2}[\w.\"']+(?:, [\w.\"']+)*) : (?=\S)")
UNDERLINE = re.compile(r"^-{3,}$")


def listed(lines: list[str]) -> list[str]:
    """The lines of a docstring, its headings bold and its descriptions items of lists."""
    found: list[str] = []
    inside = False
    for k, line in enumerate(lines):
        if UNDERLINE.match(line):
            continue
        if k + 1 < len(lines) and UNDERLINE.match(lines[k + 1]):
            found += ["", f"**{line}**", ""]
            inside = False
            continue
        item = ITEM.match(line)
        if item:
            if not inside:
                found.append("")
            name = item[1].replace("*", r"\*")
            found.append(f"* **{name}**: {line[item.end() :]}")
            inside = True
        elif inside and line.startswith(" "):
            found.append("  " + line.strip())
        else:
            if inside and line.strip():
                found.append("")
            inside = inside and not line.strip()
            found.append(line)
    return found


def reformat(_app: Sphinx, _what: str, _name: str, _object: Any, _options: Any, lines: list[str]) -> None:
    lines[:] = [escaped(line) for line in listed(lines)]


def escaped(line: str) -> str:
    """Absolute values are no substitutions: bars outside of literals are escaped."""
    parts = re.split(r"(``.*?``)", line)
    return "".join(part if part.startswith("``") else part.replace("|", r"\|") for part in parts)


def readable(
    _app: Sphinx,
    _what: str,
    _name: str,
    _object: Any,
    _options: Any,
    signature: str | None,
    returns: str | None,
) -> tuple[str | None, str | None]:
    """Signatures of dataclasses, whose made defaults ("<factory>") are no Python that Sphinx could set."""
    return re.sub(r"<[\w. ]+>", "...", signature) if signature else signature, returns


def exists(path: str) -> bool:
    """Whether a dotted path can be imported."""
    parts = path.split(".")
    for cut in range(len(parts), 0, -1):
        try:
            found: Any = importlib.import_module(".".join(parts[:cut]))
        except ModuleNotFoundError:
            continue
        for name in parts[cut:]:
            if not hasattr(found, name) and name not in getattr(found, "__dataclass_fields__", {}):
                return False
            found = getattr(found, name, None)
        return True
    return False


def plain(_app: Sphinx, _env: Any, node: Any, text: nodes.Element) -> nodes.Element | None:
    """The text of a reference to something that exists, though on no page; None for the warning otherwise."""
    if node.get("refdomain") != "py":
        return None
    # Types in signatures: NumPy's, JAX's and aliases of ours.
    if node.get("reftype") in ("class", "obj") and not node.get("refexplicit", False):
        return text
    target = node["reftarget"]
    scopes = [node.get("py:module"), f"{node.get('py:module')}.{node.get('py:class')}"]
    if any(exists(path) for path in [target, *(f"{scope}.{target}" for scope in scopes)]):
        return text
    return None


def setup(app: Sphinx) -> dict[str, bool]:
    app.connect("autodoc-process-docstring", reformat)
    app.connect("autodoc-process-signature", readable)
    app.connect("missing-reference", plain)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
