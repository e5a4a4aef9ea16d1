"""What many schemas are made of."""

from __future__ import annotations

from typing import Annotated, Generic, TypeVar

from pydantic import BaseModel, ConfigDict, Field

_T = TypeVar("_T")

#: Text that is shown to people: no control characters.
Label = Annotated[str, Field(min_length=1, max_length=200, pattern=r"^[^\x00-\x1f\x7f]*$")]
Seed = Annotated[int, Field(ge=0, lt=2**63, description="the same seed gives the same draws")]
Values = Annotated[list[float], Field(min_length=1, max_length=1000)]
Vector = Annotated[list[float], Field(min_length=3, max_length=3, description="unit vector [x, y, z]")]

#: As ids look.
ID = "0123456789abcdef0123456789abcdef"


class Request(BaseModel):
    """What a request's body is made of: no unknown fields, no infinities."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)


class Page(BaseModel, Generic[_T]):
    """Part of a list, newest first."""

    items: list[_T]
    total: int
    limit: int
    offset: int
