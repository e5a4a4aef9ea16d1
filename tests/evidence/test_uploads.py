"""The study of damaged uploads: what it sends, and that it would find what is wrong."""

from __future__ import annotations

from itertools import islice
from typing import Any

import httpx
import pytest

from tests.evidence import uploads
from tests.evidence.inputs import formats, inputs

PROBLEM = {"content-type": "application/problem+json"}


def test_every_format_comes_in_turn_and_every_input_in_its_format() -> None:
    sent = list(islice(uploads._numbered(10**6), 2 * len(formats()) * len(inputs())))
    assert {one.format for one, _ in sent[: len(formats())]} == set(formats())
    assert {one.name for one, _ in sent} == {one.name for one in inputs()}
    assert [number for _, number in sent] == list(range(len(sent)))


def test_an_upload_is_made_again_from_its_number() -> None:
    one = next(one for one in inputs() if len(one.files) > 1)
    bodies = [uploads._body(one, 7, number) for number in range(8)]
    assert bodies == [uploads._body(one, 7, number) for number in range(8)]
    assert len({body for body, _ in bodies}) == 8
    assert ["Content-Type" in headers for _, headers in bodies] == [True, False, False, False] * 2


@pytest.mark.parametrize(
    ("status", "headers", "content", "wrong"),
    [
        (201, {}, {"description": {"usable": 3}}, 0), (201, {}, {"description": {"usable": 0}}, 1),
        (422, PROBLEM, {"code": "table-truncated"}, 0), (422, {}, {"code": "table-truncated"}, 1),
        (400, PROBLEM, {"code": ""}, 1), (500, PROBLEM, {"code": "internal-error"}, 1),
        (302, {}, {"code": "x"}, 2),
    ],
)  # fmt: skip
def test_what_is_wrong_is_found(
    status: int, headers: dict[str, str], content: dict[str, Any], wrong: int
) -> None:
    answer = httpx.Response(status, headers=headers, json=content)
    assert len(uploads._wrong(answer, content)) == wrong
