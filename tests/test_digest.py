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
from fitter.formats import load
from fitter.table import Metadata
from tests.formats.samples import delimited_bytes

LARGE = np.random.default_rng(1).bytes(AT_ONCE + 1)


def test_few_bytes_at_once_many_later():
    assert digest_of(memoryview(b"abc")) == hashlib.sha256(b"abc").hexdigest()
    later = digest_of(memoryview(LARGE))
    assert isinstance(later, Digest)
    assert later.hexdigest() == hashlib.sha256(LARGE).hexdigest()
    later.begin()
    assert later.hexdigest() == hashlib.sha256(LARGE).hexdigest()


def test_metadata_reads_as_text():
    wanted = hashlib.sha256(LARGE).hexdigest()
    for begun in (False, True):
        pending = Digest(memoryview(LARGE))
        if begun:
            pending.begin()
        held = Metadata(name="a", sha256=pending)
        other = held.but(name="b")
        assert (other.name, other.sha256, held.sha256) == ("b", wanted, wanted)
        assert replace(other, name="c").sha256 == wanted
        assert asdict(other)["sha256"] == wanted
        assert pickle.loads(pickle.dumps(other)) == other
    assert Metadata().sha256 == ""
    assert Metadata(sha256=wanted) == Metadata(sha256=Digest(memoryview(LARGE)))
    assert pickle.loads(pickle.dumps(Metadata(sha256=Digest(memoryview(LARGE))))).sha256 == wanted


@pytest.mark.filterwarnings("ignore")  # JAX, where another test has imported it, warns of forks
def test_a_forked_process_has_it_too():
    pending = Digest(memoryview(LARGE))
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
