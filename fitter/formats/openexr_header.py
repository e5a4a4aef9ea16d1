"""Where an OpenEXR file's header is damaged: OpenEXR itself says that it is, not where.

Layout (OpenEXR File Layout, openexr.com/en/latest/OpenEXRFileLayout.html): magic number, version and flags (4
bytes each); then for each part its attributes, each a name and a type (text ended by 0), a size (int32) and
so many bytes, ended by a 0; a file of several parts has one more 0 behind the last.
"""

from __future__ import annotations

from dataclasses import dataclass

_SEVERAL, _LONG = 1 << 12, 1 << 10
#: Attributes that every part has, with their type and size (None: any), and those of each of several parts.
_ALWAYS: dict[str, tuple[str, int | None]] = {
    "channels": ("chlist", None), "compression": ("compression", 1), "dataWindow": ("box2i", 16),
    "displayWindow": ("box2i", 16), "lineOrder": ("lineOrder", 1), "pixelAspectRatio": ("float", 4),
    "screenWindowCenter": ("v2f", 8), "screenWindowWidth": ("float", 4),
}  # fmt: skip
_OF_PARTS: dict[str, tuple[str, int | None]] = {
    "name": ("string", None), "type": ("string", None), "chunkCount": ("int", 4),
}  # fmt: skip


@dataclass(frozen=True)
class Damage:
    """The byte of a header at which it is wrong, and the attribute there ("" where there is none)."""

    offset: int
    attribute: str


def damage(data: memoryview) -> Damage | None:
    """The first place at which the header of an OpenEXR file is none; None where its structure is whole."""
    flags = int.from_bytes(data[4:8], "little")
    if len(data) < 8 or flags & 0xFF != 2:
        return Damage(4, "version")
    longest = 255 if flags & _LONG else 31
    needed = {**_ALWAYS, **(_OF_PARTS if flags & _SEVERAL else {})}
    at = 8
    while True:
        found: set[str] = set()
        while bytes(data[at : at + 1]) not in (b"\0", b""):
            start = at
            name, at = _word(data, at, longest)
            kind, at = _word(data, at, longest)
            size = int.from_bytes(data[at : at + 4], "little", signed=True)
            stated = needed.get(name)
            fits = stated is None or (kind == stated[0] and stated[1] in (None, size))
            fits &= kind != "string" or _is_text(data[at + 4 : at + 4 + max(size, 0)])
            if not name or not kind or size < 0 or at + 4 + size > len(data) or not fits or name in found:
                return Damage(start, name)
            found.add(name)
            at += 4 + size
        missing = [name for name in needed if name not in found]
        if missing or at >= len(data):
            return Damage(min(at, len(data)), missing[0] if missing else "")
        at += 1
        if not flags & _SEVERAL or bytes(data[at : at + 1]) == b"\0":
            return None


def _is_text(words: memoryview) -> bool:
    try:
        str(words, "utf-8")
    except UnicodeDecodeError:
        return False
    return True


def _word(data: memoryview, at: int, longest: int) -> tuple[str, int]:
    """The text at ``at`` and the byte behind its end; "" for what is no name."""
    word, end, _ = bytes(data[at : at + longest + 1]).partition(b"\0")
    text = word.decode("ascii", "replace")
    return (text if end and text.isprintable() and "\N{REPLACEMENT CHARACTER}" not in text else ""), (
        at + len(word) + 1
    )
