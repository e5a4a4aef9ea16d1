"""Environments from OpenEXR: latitude-longitude pictures, checked."""

from __future__ import annotations

from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fitter.errors import SpecError

#: Pixels of a picture at most (float32 RGB: 800 MB).
_MOST = 1 << 26


def read(path: Path, channels: tuple[str, ...]) -> NDArray[np.float64]:
    """Radiance (H, W, C) of the scene's channels; a picture of one channel serves them all.

    Raises SpecError: no such file, not OpenEXR, channels that don't fit, NaN, infinite or negative pixels.
    """
    found = read_channels(path)
    names = list(found)
    if len(found) == 1:
        planes = [found[names[0]]] * len(channels)
    elif set(channels) <= set(found):
        planes = [found[name] for name in channels]
    else:
        raise SpecError(
            f"the environment has the channels {', '.join(names)}, and the scene has {', '.join(channels)}",
            code="channels-differ", file=str(path), remedy="give a picture with these channels, or with one",
        )  # fmt: skip
    picture = np.stack(planes, axis=2)
    for what, bad in (("NaN or infinite", ~np.isfinite(picture)), ("negative", picture < 0)):
        if bad.any():
            row, column, k = (int(index) for index in np.argwhere(bad)[0])
            raise SpecError(
                f"{int(bad.any(axis=2).sum())} of {bad[..., 0].size} pixels are {what}, the first at "
                f"row {row}, column {column}",
                code="bad-environment", file=str(path), row=row + 1, column=channels[k],
                cause="a picture that was merged or filtered badly", remedy="mend these pixels",
            )  # fmt: skip
    return picture


def read_channels(path: Path) -> dict[str, NDArray[np.float64]]:
    """The planes (H, W) of the first part of an OpenEXR file, by channel. Raises SpecError."""
    import OpenEXR

    try:
        with redirect_stdout(StringIO()) as printed:
            file: Any = OpenEXR.File(str(path), True, True)
        header = file.parts[0].header
        (x0, y0), (x1, y1) = header["dataWindow"]
        if (x1 - x0 + 1) * (y1 - y0 + 1) > _MOST:
            raise ValueError(f"it has more than {_MOST:,} pixels")
        with redirect_stdout(StringIO()) as printed:
            file = OpenEXR.File(str(path), True, False)
        if printed.getvalue():
            raise ValueError(printed.getvalue())
        planes = file.parts[0].channels
        return {str(name): np.asarray(one.pixels, np.float64) for name, one in planes.items()}
    except (ArithmeticError, LookupError, MemoryError, OSError, RuntimeError, TypeError, ValueError) as error:
        raise SpecError(
            f"the picture can't be read: {' '.join(str(error).split())[:120]}", code="picture-unreadable",
            file=str(path), remedy="give the path of an OpenEXR file, as seen from the scene file",
        ) from error  # fmt: skip
