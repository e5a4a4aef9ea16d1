"""Large texts are read by pyarrow: always the same rows, numbers and errors as word by word."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fitter.errors import TableError
from fitter.formats import arrow_text, delimited_header, load
from fitter.formats.arrow_text import PlainRows
from fitter.formats.source import Source

PLAIN = [
    "1",
    "-2.5",
    "+3",
    ".5",
    "5.",
    "1e5",
    "1E-5",
    "0",
    "-0.0",
    "0.1000000000000000055511151231257827",
    "007",
]
NUMBERS = [
    *PLAIN, "1e400", "-1e400", "1e-400", "4.9e-324", "inf", "-Inf", "Infinity", "nan", "NaN", "-nan", "NA",
    "n/a", "null", "None", "-", "--", "missing", "ND", "", "Missing", "nUlL",
]  # fmt: skip
WORDS = [
    *NUMBERS, "abc", "1_0", "0x1p3", "1.2.3", "1,5", "1;5", "nan(1)", "nan(x)", "e5", "1e", "1d5", "1 2",
    "1\t2", "#N/A", '"1"', '"1,2"', '"', "\u00b5", "\u0661", "1\x0c", "\x0b1", "1\x1c", "\x00", "\ufeff1",
    "1\r", "infinit", "TRUE", "12:30", "1f", "++1", "\x7f",
]  # fmt: skip
HEADERS = [
    "a,b,c",
    '"a","b","c"',
    "# note: x\na,b,c",
    "# a b c",
    "",
    "\ufeffa,b,c",
    "# rows: 4\na,b,c",
    "# \u00b5\na,b,c",
]


@st.composite
def texts(draw: st.DrawFn, words: list[str]) -> bytes:
    delimiter = draw(st.sampled_from([",", ";", "\t", " ", "  ", " , ", " \t "]))
    end = draw(st.sampled_from(["\n", "\n", "\r\n"]))
    pad = st.sampled_from(["", "", "", " "])
    odd = st.sampled_from(
        ["", "# comment", "   ", "1", delimiter.join(["1"] * 4), delimiter.join(["1"] * 3 + [""])]
    )
    lines = draw(st.sampled_from(HEADERS)).replace(",", delimiter).split("\n")
    rough = draw(st.booleans())
    for _ in range(draw(st.integers(1, 7))):
        row = delimiter.join(draw(st.sampled_from(words)) for _ in range(3))
        lines.append(draw(pad) + row + draw(pad))
        if rough and draw(st.integers(0, 5)) == 0:
            lines.append(draw(odd))
    return (end.join(lines) + draw(st.sampled_from([end, end, "", "\r"]))).encode()


def outcome(read: Any) -> Any:
    """Bits, or the error with everything it says."""
    try:
        found = read()
    except TableError as error:
        return {name: getattr(error, name) for name in ("code", "row", "column", "cause", "remedy")}, str(
            error
        )
    if isinstance(found, np.ndarray):
        return found.shape, np.where(np.isnan(found), np.nan, found).tobytes()
    return found


def agree(data: bytes) -> bool:
    """Whether pyarrow was asked; where it was, everything is as word by word."""
    plain = delimited_header._plain(Source(data, "t"), 40)
    if plain is None:
        return False
    head, rows = plain
    careful = outcome(lambda: delimited_header._word_by_word(Source(data, "t")))
    if isinstance(careful[0], dict):
        # As many lines as are stated, one of them blank: that is seen when the values are read.
        assert outcome(lambda: rows.floats([0])) == outcome(lambda: rows.texts(0)) == careful
        return True
    same_head, same = careful
    assert head == same_head
    assert list(rows.names) == list(same.names)
    for use in ([0, 1, 2], [2], [1, 0]):
        if max(use) < len(same.names):
            assert outcome(lambda use=use: rows.floats(use)) == outcome(lambda use=use: same.floats(use))
    assert outcome(lambda: rows.texts(0)) == outcome(lambda: same.texts(0))
    return True


@given(texts(PLAIN))
def test_numbers(data: bytes):
    agree(data)


@given(texts(NUMBERS))
def test_missing_and_extreme_numbers(data: bytes):
    agree(data)


@given(texts(WORDS))
def test_any_words(data: bytes):
    agree(data)


@given(st.lists(st.floats(), min_size=1, max_size=9), st.sampled_from(["%r", "%.17g", "%.6e", "%.3f"]))
def test_every_float(numbers: list[float], form: str):
    lines = [f"{form % x},0,{form % -x}" for x in numbers]
    assert agree("\n".join(["a,b,c", *lines, ""]).encode())


@pytest.mark.parametrize("word", [*WORDS, "-", "1e5"])
@pytest.mark.parametrize("delimiter", [",", "\t", " "])
def test_each_word(word: str, delimiter: str):
    """In a column that is used, and in one that is not."""
    rows = [["1", "2", "3"], ["4", word, "6"], ["7", "8", word]]
    agree("\n".join(delimiter.join(row) for row in [["a", "b", "c"], *rows, ["0", "0", "0"]]).encode())


def test_pyarrow_reads_what_is_plain(monkeypatch: pytest.MonkeyPatch):
    """It is not the careful reader that makes the two agree."""
    monkeypatch.setattr(PlainRows, "_word_by_word", property(lambda self: pytest.fail("read word by word")))
    for delimiter in (",", ";", "\t", " ", "   "):
        for end in ("\n", "\r\n"):
            lines = ["a,b,c", "1,NA,3", " 4,-,nan ", "7,8e-3,9", ""]
            plain = delimited_header._plain(Source(end.join(lines).replace(",", delimiter).encode(), "t"), 12)
            assert plain is not None
            np.testing.assert_array_equal(plain[1].floats([0, 2]), [[1, 3], [4, np.nan], [7, 9]])
            np.testing.assert_array_equal(plain[1].floats([1])[:, 0], [np.nan, np.nan, 8e-3])
            assert list(plain[1].numbers) == [2, 3, 4]


def large(rows: int, seed: int = 1) -> list[str]:
    rng = np.random.default_rng(seed)
    numbers = np.column_stack(
        [rng.uniform(0, 80, (rows, 2)), rng.uniform(0, 360, rows), rng.uniform(0, 1, (rows, 2))]
    )
    return [
        "theta_i_deg,theta_o_deg,dphi_deg,brdf_R,brdf_G",
        *(",".join(map(repr, row)) for row in numbers.tolist()),
    ]


@pytest.fixture
def small_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(delimited_header, "SMALLEST", 1000)


def test_a_table_is_the_same_either_way(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    lines = large(300)
    (tmp_path / "t.csv").write_text("\n".join([*lines, lines[7], ""]))
    careful = load(tmp_path / "t.csv")
    monkeypatch.setattr(delimited_header, "SMALLEST", 1000)
    quick = load(tmp_path / "t.csv")
    assert (quick.hash, quick.metadata, quick.channels) == (careful.hash, careful.metadata, careful.channels)
    assert quick.metadata.masked == {"repeated geometry": 1}


@pytest.mark.usefixtures("small_limit")
@pytest.mark.parametrize(
    ("row", "column", "cell", "code"),
    [(200, 3, "wrong", "table-not-a-number"), (150, 1, "97", None), (120, 0, "200", "table-angle-range"),
     (299, 4, "1,2", "table-row-width")],
)  # fmt: skip
def test_errors_name_the_place(row: int, column: int, cell: str, code: str | None):
    lines = large(300)
    cells = lines[row].split(",")
    cells[column] = cell
    lines[row] = ",".join(cells)
    data = "\n".join([*lines, ""]).encode()
    if code is None:
        assert load(data).metadata.masked == {"below the horizon": 1}
        return
    with pytest.raises(TableError) as caught:
        load(data, name="t.csv")
    assert (caught.value.code, caught.value.file, caught.value.row) == (code, "t.csv", row + 1)


@pytest.mark.usefixtures("small_limit")
def test_a_column_of_names():
    lines = large(200)
    named = [f"{lines[0]},item", *(f"{line},{'ab'[k % 2]} " for k, line in enumerate(lines[1:]))]
    assert len(load("\n".join(named).encode(), item="b")) == 100


def test_the_limit_is_above_small_files():
    assert arrow_text.SMALLEST > 1_000_000
