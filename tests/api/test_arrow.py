"""Arrow streams in and out: the same numbers as in JSON; what is no stream of vectors is a problem."""

from __future__ import annotations

import io
from typing import Any

import numpy as np
import pyarrow
import pytest

import fitter

ARROW = "application/vnd.apache.arrow.stream"
WI = [0.6, 0.0, 0.8]


@pytest.fixture(scope="module")
def same(table_bytes: bytes) -> fitter.Table:
    """The table as the library reads it."""
    return fitter.load(table_bytes)


def stream(columns: dict[str, Any]) -> bytes:
    whole = pyarrow.table(columns)
    out = io.BytesIO()
    with pyarrow.ipc.new_stream(out, whole.schema) as writer:
        writer.write_table(whole, max_chunksize=3)
    return out.getvalue()


def vectors(w: np.ndarray) -> Any:
    return pyarrow.FixedSizeListArray.from_arrays(pyarrow.array(w.reshape(-1)), 3)


@pytest.mark.long
def test_draws_as_a_stream(client: Any, table: str, same: fitter.Table) -> None:
    wanted = {"wi": WI, "n": 50, "seed": 7}
    answer = client.post(f"/v1/tables/{table}/samples", json=wanted, headers={"accept": ARROW})
    assert answer.headers["content-type"] == ARROW
    found = pyarrow.ipc.open_stream(answer.content).read_all()
    drawn = fitter.TableSampler(same).sample(np.array(WI), 50, seed=7)
    np.testing.assert_array_equal(np.stack(found["wo"].to_numpy()), drawn.wo)
    np.testing.assert_array_equal(np.stack(found["weight"].to_numpy()), drawn.weight)
    np.testing.assert_array_equal(found["pdf"].to_numpy(), drawn.pdf)
    assert found["valid"].to_pylist() == [True] * 50
    about = {key.decode(): value.decode() for key, value in found.schema.metadata.items()}
    assert about["channels"] == "R,G,B"
    assert about["Sampling-Seed"] == "7"


def test_directions_as_a_stream(client: Any, table: str, same: fitter.Table) -> None:
    rng = np.random.default_rng(1)
    w = np.abs(rng.normal(size=(2, 8, 3)))
    w /= np.linalg.norm(w, axis=2, keepdims=True)
    body = stream({"wo": vectors(w[1]), "wi": vectors(w[0])})
    headers = {"content-type": ARROW, "accept": f"application/json;q=0.5, {ARROW}"}
    answer = client.post(f"/v1/tables/{table}/evaluate", content=body, headers=headers)
    found = pyarrow.ipc.open_stream(answer.content).read_all()
    values, extrapolated = same.evaluate(w[0], w[1])
    np.testing.assert_array_equal(np.stack(found["value"].to_numpy()), values)
    assert found["extrapolated"].to_pylist() == extrapolated.tolist()


ONE = np.array([[0.0, 0.0, 1.0]])


@pytest.mark.parametrize(
    ("body", "code"),
    [
        (b"", "bad-arrow"), (b"{}", "bad-arrow"),
        (stream({"wi": vectors(ONE), "wo": vectors(ONE)})[:-40], None),
        (stream({"wi": vectors(ONE)}), "bad-request"), (stream({"wi": [1.0], "wo": [1.0]}), "bad-directions"),
        (stream({"wi": [[0.0, 0.0, 1.0], None], "wo": [[0.0, 0.0, 1.0]] * 2}), "bad-directions"),
        (stream({"wi": [[0.0, 0.0], [0.0, 0.0, 1.0, 0.0]], "wo": [[0.0, 0.0, 1.0]] * 2}), "bad-directions"),
        (stream({"wi": [["a", "b", "c"]], "wo": [[0.0, 0.0, 1.0]]}), "bad-directions"),
        (stream({"wi": vectors(np.zeros((0, 3))), "wo": vectors(np.zeros((0, 3)))}), "bad-directions"),
    ],
)  # fmt: skip
def test_bad_streams(client: Any, table: str, body: bytes, code: str | None) -> None:
    answer = client.post(f"/v1/tables/{table}/evaluate", content=body, headers={"content-type": ARROW})
    assert answer.status_code in (400, 422), answer.text
    assert code is None or answer.json()["code"] == code
