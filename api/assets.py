"""Assets: the files that the page is made of, under an address that changes with their content.

The page's own scripts and style lie in ``api/page``, Plotly's bundle in its wheel, which the lock file pins.
"""

from __future__ import annotations

import gzip
import hashlib
import mimetypes
from dataclasses import dataclass
from functools import cached_property
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path

#: Of the <style> elements that Plotly makes: an empty one, into which it inserts rules, and 3-D plots' own.
STYLES = (
    "'sha256-47DEQpj8HBSa+/TImW+5JCeuQeRkm5NMpJWZG3hSuFU='",
    "'sha256-ji27qzEtxXZW+7dun6UwjHXJ18e6WAin1VvNtkzIE/o='",
)
#: Of the page. Nothing is evaluated and no other style element is allowed; Plotly sets style attributes.
POLICY = "; ".join(
    [
        "default-src 'none'", "script-src 'self'", "connect-src 'self'", "img-src 'self' data: blob:",
        f"style-src-elem 'self' {' '.join(STYLES)}", "style-src-attr 'unsafe-inline'", "base-uri 'none'",
        "form-action 'none'", "frame-ancestors 'none'",
    ]
)  # fmt: skip
HEADERS = {
    "Content-Security-Policy": POLICY, "X-Content-Type-Options": "nosniff", "Referrer-Policy": "no-referrer",
}  # fmt: skip
#: Files smaller than this are sent as they are.
WORTH_PACKING = 1024


@dataclass(frozen=True)
class Asset:
    """One file, read when it is first asked for."""

    path: Path

    @cached_property
    def content(self) -> bytes:
        return self.path.read_bytes()

    @cached_property
    def packed(self) -> bytes | None:
        """gzip, where that is worth it."""
        return None if len(self.content) < WORTH_PACKING else gzip.compress(self.content, 6, mtime=0)

    @property
    def media_type(self) -> str:
        found = "text/javascript" if self.path.suffix == ".js" else mimetypes.guess_type(self.path.name)[0]
        return found or "application/octet-stream"


class Assets:
    """The files by name, and the digest that stands for all of them."""

    def __init__(self) -> None:
        folder = Path(__file__).parent / "page"
        self._files = {
            path.relative_to(folder).as_posix(): Asset(path)
            for path in sorted(folder.rglob("*")) if path.suffix in (".js", ".css", ".svg")
        }  # fmt: skip
        digest = hashlib.sha256(version("plotly").encode())
        for name, asset in self._files.items():
            digest.update(name.encode() + b"\0" + asset.content + b"\0")
        self.digest = digest.hexdigest()[:16]
        self._files["plotly.js"] = Asset(_plotly() / "package_data" / "plotly.min.js")
        self._page = (folder / "index.html").read_text()

    def get(self, name: str) -> Asset | None:
        """The file of that name."""
        return self._files.get(name)

    def page(self, **words: str) -> str:
        """The page, with ``$assets`` and the given words put in."""
        modules = "\n".join(
            f'<link rel="modulepreload" href="$assets/{name}">'
            for name in self._files if name.endswith(".js") and name != "plotly.js"
        )  # fmt: skip
        text = self._page.replace("$modules", modules).replace("$assets", f"page/{self.digest}")
        for name, word in words.items():
            text = text.replace(f"${name}", word)
        return text


def _plotly() -> Path:
    """The folder of the package, which need not be imported."""
    found = find_spec("plotly")
    assert found is not None
    assert found.submodule_search_locations
    return Path(found.submodule_search_locations[0])
