"""Damage to the bytes of a file, as copying, editing and transfers do it; drawn from a generator.

Half of the damage of a kind goes to the first 2,000 bytes, where headers are.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping

import numpy as np

Rng = np.random.Generator
Mutation = Callable[[bytes, bytes, Rng], bytes]

_HEAD = 2000
_NUMBER = re.compile(rb"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
_COUNT = re.compile(rb"(?<![\w.])\d+(?![\w.])")
#: What is put in a number's place.
_NUMBERS = (
    b"nan", b"NaN", b"inf", b"-inf", b"1e999", b"-1e999", b"1e308", b"5e-324", b"0", b"-0", b"-1", b"1e9",
    b"2147483648", b"18446744073709551616", b"9" * 400, b"1_0", b"0x10", b"1,5", b"--1", b"1e", b"", b"+",
    b"\xd9\xa3", b"\xc2\xb2", b"1 2", b"1;2", b"'1'", b'"1', b"#1", b"1\n", b"\t", b"None", b"1j", b"360.1",
)  # fmt: skip
_COUNTS = (
    b"0", b"1", b"-1", b"2", b"999", b"100000", b"2147483647", b"4294967296", b"9223372036854775807",
    b"9" * 30, b"1.5", b"1e6", b"",
)  # fmt: skip
_WORDS = (0, 1, 2, 3, 255, 0x7FFF, 0xFFFF, 0x10000, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF)


def _place(data: bytes, rng: Rng) -> int:
    return int(rng.integers(min(len(data), _HEAD) if rng.random() < 0.5 else len(data)))


def _length(data: bytes, rng: Rng) -> int:
    """Mostly a few bytes, at times a tenth of the file."""
    return int(np.exp(rng.uniform(0.0, np.log(max(len(data) / 10, 2.0)))))


def flipped(data: bytes, other: bytes, rng: Rng) -> bytes:
    """One to eight bits."""
    changed = bytearray(data)
    for _ in range(int(rng.integers(1, 9))):
        changed[_place(data, rng)] ^= 1 << int(rng.integers(8))
    return bytes(changed)


def run_of_bytes(data: bytes, other: bytes, rng: Rng) -> bytes:
    """A run of one byte, or of random ones, in place."""
    at, n = _place(data, rng), _length(data, rng)
    fill = rng.choice([0x00, 0xFF, 0x20, 0x0A, 0x7F, 0x39, -1])
    run = rng.bytes(n) if fill < 0 else bytes([int(fill)]) * n
    return data[:at] + run[: len(data) - at] + data[at + n :]


def truncated(data: bytes, other: bytes, rng: Rng) -> bytes:
    """Cut off at the end, at times at the beginning."""
    at = _place(data, rng)
    return data[at:] if rng.random() < 0.2 else data[:at]


def spliced(data: bytes, other: bytes, rng: Rng) -> bytes:
    """A piece of another file, put in or put over, or the other file's rest."""
    at, n = _place(data, rng), _length(other, rng)
    start = _place(other, rng)
    piece = other[start : start + n]
    how = int(rng.integers(3))
    if how == 2:
        return data[:at] + other[start : start + len(data)]
    return data[:at] + piece + data[at + (len(piece) if how else 0) :]


def moved(data: bytes, other: bytes, rng: Rng) -> bytes:
    """A piece of the file itself deleted, doubled, or exchanged with another."""
    a, n = _place(data, rng), _length(data, rng)
    piece = data[a : a + n]
    how = int(rng.integers(3))
    if how == 0:
        return data[:a] + data[a + n :]
    if how == 1:
        return data[:a] + piece + data[a:]
    b = _place(data, rng)
    changed = bytearray(data)
    changed[b : b + len(piece)] = piece
    return bytes(changed[: len(data)])


def lines(data: bytes, other: bytes, rng: Rng) -> bytes:
    """One to four lines deleted, doubled, exchanged, blanked, cut or joined to the next."""
    found = data.split(b"\n")
    for _ in range(int(rng.integers(1, 5))):
        k = int(rng.integers(min(len(found), 30) if rng.random() < 0.5 else len(found)))
        match int(rng.integers(6)):
            case 0 if len(found) > 1:
                del found[k]
            case 1:
                found.insert(k, found[k])
            case 2:
                j = int(rng.integers(len(found)))
                found[k], found[j] = found[j], found[k]
            case 3:
                found[k] = b""
            case 4:
                found[k] = found[k][: int(rng.integers(len(found[k]) + 1))]
            case _ if k + 1 < len(found):
                found[k : k + 2] = [found[k] + found[k + 1]]
            case _:
                pass
    return b"\n".join(found)


def number(data: bytes, other: bytes, rng: Rng) -> bytes:
    """One to three numbers of a text replaced by others, or by what is none; bytes of a binary file."""
    changed = data
    for _ in range(int(rng.integers(1, 4))):
        if not changed:
            return changed
        at = _place(changed, rng)
        found = _NUMBER.search(changed, at, at + 400)
        if found is None:
            changed = _overwritten(changed, rng.choice([np.nan, np.inf, -np.inf, 1e300, -1.0, 1e-310]), rng)
        else:
            word = _NUMBERS[int(rng.integers(len(_NUMBERS)))]
            changed = changed[: found.start()] + word + changed[found.end() :]
    return changed


def _overwritten(data: bytes, value: float, rng: Rng) -> bytes:
    kind = "<f8" if rng.random() < 0.5 else "<f4"
    with np.errstate(over="ignore", under="ignore"):
        word = np.array([value]).astype(kind).tobytes()
    at = _place(data, rng) // 4 * 4
    return data[:at] + word[: len(data) - at] + data[at + len(word) :]


def count(data: bytes, other: bytes, rng: Rng) -> bytes:
    """A whole number of the header made huge, negative, zero, or one off."""
    found = list(_COUNT.finditer(data[:_HEAD]))
    text = data.isascii() or b"\0" not in data[:_HEAD]
    if found and text:
        one = found[int(rng.integers(len(found)))]
        if rng.random() < 0.4:
            word = str(max(int(one[0][:9]) + int(rng.choice([-1, 1, 10])), 0)).encode()
        else:
            word = _COUNTS[int(rng.integers(len(_COUNTS)))]
        return data[: one.start()] + word + data[one.end() :]
    width = int(rng.choice([1, 2, 4, 8]))
    at = int(rng.integers(max(min(len(data), 400) - width, 1)))
    value = int(rng.choice(_WORDS))
    if rng.random() < 0.3:
        value = int.from_bytes(data[at : at + width], "little") + int(rng.choice([-1, 1]))
    if width == 8 and rng.random() < 0.5:
        value = (1 << 63) + value
    word = (value % (1 << (8 * width))).to_bytes(width, "little")
    return data[:at] + word + data[at + width :]


MUTATIONS: Mapping[str, Mutation] = {
    "bit flips": flipped, "run of bytes": run_of_bytes, "truncation": truncated, "splice": spliced,
    "piece moved": moved, "lines": lines, "number": number, "header count": count,
}  # fmt: skip


def mutate(data: bytes, other: bytes, rng: Rng) -> tuple[str, bytes]:
    """``(kind, damaged bytes)``: ``data`` damaged in one way of ``MUTATIONS``, at times in two."""
    names = list(MUTATIONS)
    name = names[int(rng.integers(len(names)))]
    changed = MUTATIONS[name](data, other, rng)
    if changed and rng.random() < 0.15:
        second = names[int(rng.integers(len(names)))]
        return f"{name}, {second}", MUTATIONS[second](changed, other, rng)
    return name, changed
