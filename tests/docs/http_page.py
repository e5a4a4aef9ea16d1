"""Makes docs/http-reference.md from docs/openapi.json: ``python -m tests.docs.http_page``."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

DOCS = Path(__file__).resolve().parents[2] / "docs"
PAGE, INTERFACE = DOCS / "http-reference.md", DOCS / "openapi.json"

HEAD = """# HTTP reference

Made by `python -m tests.docs.http_page` from [openapi.json](openapi.json), which a test compares with
the running service. [http.md](http.md) shows how the operations go together.
"""
ERRORS = "application/problem+json"
Document = Mapping[str, Any]


def page(interface: Document) -> str:
    """docs/http-reference.md for an interface."""
    operations = list(_operations(interface))
    schemas = interface["components"]["schemas"]
    lines = [HEAD, interface["info"]["description"].replace("\n", " "), ""]
    for tag in dict.fromkeys(tag for *_, tag in operations):
        lines += [f"## Operations: {tag}", ""]
        for verb, path, operation, of in operations:
            if of == tag:
                lines += _operation(verb, path, operation)
    lines += [*_errors(operations), "## Documents", ""]
    for name, schema in sorted(schemas.items()):
        lines += _schema(name, schema)
    return "\n".join(lines).rstrip() + "\n"


def _operations(interface: Document) -> Iterator[tuple[str, str, Document, str]]:
    for path, verbs in interface["paths"].items():
        for verb, operation in verbs.items():
            yield verb.upper(), path, operation, operation["tags"][0]


def _operation(verb: str, path: str, operation: Document) -> Iterator[str]:
    yield f"### `{verb} {path}`"
    yield ""
    yield _text(operation.get("description", operation["summary"]))
    yield ""
    parameters = operation.get("parameters", [])
    if parameters:
        yield "| parameter | in | type | what it is |"
        yield "|---|---|---|---|"
        for given in parameters:
            needed = " (required)" if given.get("required") and given["in"] != "path" else ""
            words = _cell(given.get("description", given["schema"].get("description", "")))
            yield f"| `{given['name']}` | {given['in']} | {_type(given['schema'])}{needed} | {words} |"
        yield ""
    if "requestBody" in operation:
        content = operation["requestBody"]["content"]
        yield f"- takes {_content(content)}"
    refusals: list[str] = []
    for status, answer in operation["responses"].items():
        content = answer.get("content", {})
        if ERRORS in content:
            refusals.append(status)
            continue
        what = f": {_content(content)}" if content else ""
        yield f"- {status}{what}{_headers(answer)}"
    if refusals:
        yield f"- refused with {', '.join(refusals)} ([errors](#errors))"
    scopes = sorted({scope for need in operation.get("security", []) for scope in need.get("key", [])})
    if scopes:
        yield f"- scope of the key: {', '.join(f'`{scope}`' for scope in scopes)}"
    yield ""


def _errors(operations: Sequence[tuple[str, str, Document, str]]) -> Iterator[str]:
    """What each status of a refusal means, in the words of the operations."""
    meanings: dict[str, dict[str, None]] = {}
    for *_, operation, _tag in operations:
        for status, answer in operation["responses"].items():
            if ERRORS in answer.get("content", {}):
                meanings.setdefault(status, {})[answer["description"]] = None
    yield "## Errors"
    yield ""
    yield f"Always a [ProblemDocument](#problemdocument), `{ERRORS}`."
    yield ""
    yield "| status | because |"
    yield "|---|---|"
    for status, words in sorted(meanings.items()):
        yield f"| {status} | {_cell('; or: '.join(words))} |"
    yield ""


def _schema(name: str, schema: Document) -> Iterator[str]:
    yield f"### {name}"
    yield ""
    if "description" in schema:
        yield _text(schema["description"])
        yield ""
    fields = schema.get("properties", {})
    if not fields:
        yield _type(schema)
        yield ""
        return
    yield "| field | type | what it is |"
    yield "|---|---|---|"
    for field, of in fields.items():
        needed = "" if field in schema.get("required", ()) else ", optional"
        default = f", default `{json.dumps(of['default'])}`" if of.get("default") is not None else ""
        yield f"| `{field}` | {_type(of)}{needed}{default} | {_cell(of.get('description', ''))} |"
    yield ""


def _type(schema: Document) -> str:
    """A JSON schema in a few words; documents are links."""
    if "$ref" in schema:
        name = schema["$ref"].rpartition("/")[2]
        return f"[{name}](#{name.lower()})"
    if "const" in schema:
        return f"`{json.dumps(schema['const'])}`"
    if "enum" in schema:
        return " or ".join(f"`{json.dumps(one)}`" for one in schema["enum"])
    for key in ("anyOf", "oneOf", "allOf"):
        if key in schema:
            return " or ".join(dict.fromkeys(_type(one) for one in schema[key]))
    kind = schema.get("type", "anything")
    if kind == "array":
        within = [_type(one) for one in schema.get("prefixItems", ())] or [_type(schema.get("items", {}))]
        return f"list of {', '.join(within)}"
    if kind == "object":
        of = schema.get("additionalProperties")
        return f"object of {_type(of)}" if isinstance(of, Mapping) and of else "object"
    return f"{kind}{_range(schema)}"


def _range(schema: Document) -> str:
    words = {"minimum": "from", "exclusiveMinimum": "above", "maximum": "to", "exclusiveMaximum": "below"}
    found = [f"{word} {schema[key]:g}" for key, word in words.items() if key in schema]
    return f" {' '.join(found)}" if found else ""


def _content(content: Document) -> str:
    found: list[str] = []
    for kind, body in content.items():
        schema = body.get("schema", {})
        shown = _type(schema) if schema and schema.get("type") != "string" else ""
        found.append(f"`{kind}`" + (f" {shown}" if shown and shown != "anything" else ""))
    return " or ".join(found)


def _headers(answer: Document) -> str:
    names = answer.get("headers", {})
    return f", with {', '.join(f'`{name}`' for name in names)}" if names else ""


def _text(words: str) -> str:
    return words.replace("``", "`").strip()


def _cell(words: str) -> str:
    return " ".join(_text(words).split()).replace("|", "\\|")


if __name__ == "__main__":
    PAGE.write_text(page(json.loads(INTERFACE.read_text())))
