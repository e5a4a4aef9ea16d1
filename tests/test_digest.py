"""Digests that are computed beside the reading: what they say, and who waits for them."""

from __future__ import annotations

import hashlib
import os
import pickle
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

from fitter.digest import AT_ONCE, Digest, digest_of
from fitter.errors import TableError
from fitter.formats import load
from fitter.formats.source import Source
from fitter.metadata import Metadata
from tests.formats.samples import delimited_bytes

LARGE = np.random.default_rng(1).bytes(AT_ONCE + 1)


def _later(content: bytes) -> Digest:
    found = digest_of(memoryview(content))
    assert isinstance(found, Digest)
    return found


def test_few_bytes_at_once_many_later():
    assert digest_of(memoryview(b"abc")) == hashlib.sha256(b"abc").hexdigest()
    later = _later(LARGE)
    assert later.hexdigest() == hashlib.sha256(LARGE).hexdigest()
    later.begin()
    assert later.hexdigest() == hashlib.sha256(LARGE).hexdigest()


def test_metadata_reads_as_text():
    wanted = hashlib.sha256(LARGE).hexdigest()
    for begun in (False, True):
        pending = _later(LARGE)
        if begun:
            pending.begin()
        held = Metadata(name="a", sha256=pending)
        other = held.but(name="b")
        assert (other.name, other.sha256, held.sha256) == ("b", wanted, wanted)
        assert replace(other, name="c").sha256 == wanted
        assert asdict(other)["sha256"] == wanted
        assert pickle.loads(pickle.dumps(other)) == other
    assert Metadata().sha256 == ""
    assert Metadata(sha256=wanted) == Metadata(sha256=_later(LARGE))
    assert pickle.loads(pickle.dumps(Metadata(sha256=_later(LARGE)))).sha256 == wanted


@pytest.mark.filterwarnings("ignore")  # JAX, where another test has imported it, warns of forks
def test_a_forked_process_has_it_too():
    pending = _later(LARGE)
    pending._begun = True  # as a fork sees it whose parent's thread has not come to it yet
    child = os.fork()
    if not child:
        os._exit(0 if pending.hexdigest() == hashlib.sha256(LARGE).hexdigest() else 1)
    assert os.waitpid(child, 0)[1] == 0


def test_the_bytes_that_were_read(tmp_path: Path):
    """Whatever happens to the file afterwards."""
    data = delimited_bytes() + b"# " + b"x" * AT_ONCE + b"\n"
    path = tmp_path / "t.csv"
    path.write_bytes(data)
    table = load(path)
    path.write_bytes(b"other")
    path.unlink()
    assert table.metadata.sha256 == hashlib.sha256(data).hexdigest()


@pytest.fixture(scope="module")
def large(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A text that is read part by part."""
    path = tmp_path_factory.mktemp("large") / "t.csv"
    angles = np.random.default_rng(2).uniform(0, 80, (300_000, 3))
    lines = [f"{i!r},{o!r},{a!r},0.25" for i, o, a in angles.tolist()]
    path.write_text("\n".join(["theta_i_deg,theta_o_deg,dphi_deg,brdf", *lines, ""]))
    assert path.stat().st_size > 1 << 24
    return path


def test_a_large_text_by_parts_is_the_text(large: Path):
    whole, parts = load(large.read_bytes(), name="t"), load(large, name="t")
    assert parts.metadata.sha256 == whole.metadata.sha256 == hashlib.sha256(large.read_bytes()).hexdigest()
    for name in ("wi", "wo", "value", "mask"):
        np.testing.assert_array_equal(getattr(parts, name), getattr(whole, name))


def test_a_large_text_without_its_last_line_end(large: Path, tmp_path: Path):
    path = tmp_path / "t.csv"
    path.write_bytes(large.read_bytes()[:-1])
    assert len(load(path)) == len(load(large))
    assert any("no line end" in note for note in load(path).metadata.notes)


@pytest.mark.parametrize("change", ["longer", "shorter", "another", "gone"])
def test_a_file_that_changes_meanwhile_is_refused(large: Path, tmp_path: Path, change: str):
    path = tmp_path / "t.csv"
    path.write_bytes(large.read_bytes())
    source = Source(path)
    assert source.part(0, 11) == b"theta_i_deg"
    if change in ("longer", "shorter"):
        with path.open("r+b") as file:
            file.truncate(source.size + (10 if change == "longer" else -10))
    else:
        path.unlink()
        if change == "another":
            path.write_bytes(large.read_bytes())
    with pytest.raises(TableError) as caught:
        source.release()
    assert caught.value.code == ("file-missing" if change == "gone" else "file-changed")
    assert caught.value.file == "t.csv"
    assert caught.value.remedy
