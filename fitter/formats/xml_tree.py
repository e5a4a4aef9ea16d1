"""XML as a tree of elements, for files that nobody vouches for: no document types, hence no entities."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NoReturn
from xml.parsers import expat

from fitter.formats.source import Source

#: Beyond these a file is no table but an attempt to fill the memory: an element costs a hundred of its bytes.
_DEEPEST, _MOST = 64, 200_000


@dataclass
class Element:
    """One element. ``name`` has no namespace prefix; ``row`` is the line its start tag begins on, from 1."""

    name: str
    row: int
    attributes: dict[str, str]
    children: list[Element] = field(default_factory=list["Element"])
    pieces: list[str] = field(default_factory=list[str])

    @property
    def text(self) -> str:
        """Its own characters, white space at both ends stripped."""
        return "".join(self.pieces).strip()

    def all(self, name: str) -> Iterator[Element]:
        """Its children of that name, in any case of letters."""
        return (child for child in self.children if child.name.lower() == name.lower())

    def first(self, *path: str) -> Element | None:
        """The first descendant along ``path``, or None."""
        found: Element | None = self
        for name in path:
            found = next(found.all(name), None) if found is not None else None
        return found

    def words(self, *path: str) -> str:
        """The text of the first descendant along ``path``; "" where there is none."""
        found = self.first(*path)
        return "" if found is None else found.text


def parse_xml(source: Source) -> Element:
    """The root element. Raises TableError for a document type, for damage, and for absurd nesting."""
    parser = expat.ParserCreate()
    parser.buffer_text = True
    root = Element("", 0, {})
    open_elements = [root]
    count = 0

    def start(name: str, attributes: dict[str, str]) -> None:
        nonlocal count
        count += 1
        if len(open_elements) > _DEEPEST or count > _MOST:
            raise source.error(
                f"the XML has more than {_MOST:,} elements" if count > _MOST
                else f"the XML is nested more than {_DEEPEST} deep", "table-xml",
                row=parser.CurrentLineNumber, remedy="use a file of the format's own layout",
            )  # fmt: skip
        element = Element(name.rsplit(":", 1)[-1], parser.CurrentLineNumber, attributes)
        open_elements[-1].children.append(element)
        open_elements.append(element)

    def end(name: str) -> None:
        open_elements.pop()

    def characters(piece: str) -> None:
        open_elements[-1].pieces.append(piece)

    def doctype(name: str, system: str | None, public: str | None, internal: bool) -> NoReturn:
        # Entities can only be declared here: without it none can grow or reach outside the file.
        raise source.error(
            "the XML has a document type declaration", "table-xml-doctype", row=parser.CurrentLineNumber,
            cause="it could define entities that reach outside the file or unfold without end",
            remedy="delete the <!DOCTYPE ...> line",
        )  # fmt: skip

    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.CharacterDataHandler = characters
    parser.StartDoctypeDeclHandler = doctype
    try:
        parser.Parse(source.data, True)
    except expat.ExpatError as error:
        raise source.error(
            f"the XML can't be read: {expat.ErrorString(error.code)}", "table-xml", row=error.lineno,
            cause="the file is cut off or damaged", remedy="fetch the file again",
        ) from error  # fmt: skip
    except (LookupError, ValueError) as error:  # an encoding that Python has no 8-bit table for
        raise source.error(
            "the encoding that the XML names can't be read", "text-encoding", row=1,
            remedy="save it as UTF-8",
        ) from error  # fmt: skip
    return root.children[0]
