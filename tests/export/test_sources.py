"""The sources say what the library says: C compiled, Python run, GLSL checked by its compiler and run.

There is no graphics processor where tests run. GLSL's float arithmetic is that of C++ on float, and a snippet
is in what both have in common, so it is run as such; that it is GLSL at all is glslang's word.
"""

from __future__ import annotations

import ctypes
import os
import re
import runpy
import shutil
import subprocess
import sysconfig
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from fitter.errors import SpecError
from fitter.export import write
from fitter.models import ReflectanceModel, create
from tests.export.conftest import SOURCES, FloatArray, make

Pairs = tuple[FloatArray, FloatArray]

_GLSL_AS_CPP = """
#include <cmath>
struct vec3 { float x, y, z; vec3(float a, float b, float c) : x(a), y(b), z(c) {} };
static float sqrt(float x) { return std::sqrt(x); }
static float exp(float x) { return std::exp(x); }
static float log(float x) { return std::log(x); }
static float sin(float x) { return std::sin(x); }
static float cos(float x) { return std::cos(x); }
static float atan(float y, float x) { return std::atan2(y, x); }
static float min(float a, float b) { return b < a ? b : a; }
static float max(float a, float b) { return a < b ? b : a; }
"""
_MANY = """
extern "C" void many{k}(int n, const float *i, const float *o, float *f) {{
    for (; n--; i += 3, o += 3, f += 3) {{
        vec3 v = m{k}::brdf(vec3(i[0], i[1], i[2]), vec3(o[0], o[1], o[2]));
        f[0] = v.x; f[1] = v.y; f[2] = v.z;
    }}
}}
"""


@pytest.fixture(scope="module")
def models() -> dict[str, ReflectanceModel]:
    return {name: make(name) for name in SOURCES}


@pytest.fixture(scope="module")
def expected(models: dict[str, ReflectanceModel], pairs: Pairs) -> dict[str, FloatArray]:
    return {name: np.asarray(model.evaluate(*pairs)) for name, model in models.items()}


def _pointer(array: NDArray[Any]) -> ctypes.c_void_p:
    return array.ctypes.data_as(ctypes.c_void_p)


def _needed(program: str) -> str:
    found = shutil.which(program)
    if found is None:
        pytest.skip(f"NO {program.upper()}: exported sources are not checked")
    return found


@pytest.mark.long
def test_c_compiles_without_warnings_and_is_the_model(
    models: dict[str, ReflectanceModel], expected: dict[str, FloatArray], pairs: Pairs, tmp_path: Path
) -> None:
    driver = "void many(int n, const double *i, const double *o, double *f)\n"
    driver += "{ for (; n--; i += 3, o += 3, f += 3) brdf(i, o, f); }\n"
    for k, (name, model) in enumerate(models.items()):
        write(model, "c", tmp_path / "m.c")
        (tmp_path / "many.c").write_text('#include "m.c"\n' + driver)
        library = tmp_path / f"m{k}.so"
        subprocess.run(
            [_needed("gcc"), "-std=c99", "-pedantic", "-Wall", "-Wextra", "-Werror", "-O0", "-shared",
             "-fPIC", "-o", library, tmp_path / "many.c", "-lm"], check=True,
        )  # fmt: skip
        value = np.zeros((len(pairs[0]), 3))
        ctypes.CDLL(str(library)).many(len(value), *map(_pointer, (*pairs, value)))
        np.testing.assert_allclose(value, expected[name], rtol=1e-12, atol=1e-300, err_msg=name)


def test_python_runs_and_is_the_model(
    models: dict[str, ReflectanceModel], expected: dict[str, FloatArray], pairs: Pairs, tmp_path: Path
) -> None:
    for name, model in models.items():
        write(model, "python", tmp_path / "m.py")
        assert not re.search(r"^\s*(import|from (?!math))", (tmp_path / "m.py").read_text(), re.MULTILINE)
        brdf = runpy.run_path(str(tmp_path / "m.py"))["brdf"]
        value = [brdf(i, o) for i, o in zip(*(w.tolist() for w in pairs), strict=True)]
        np.testing.assert_allclose(value, expected[name], rtol=1e-12, atol=1e-300, err_msg=name)
        assert brdf((0.0, 0.0, 1.0), (0.6, 0.0, -0.8)) == (0.0, 0.0, 0.0)


def test_glsl_is_the_model_within_float32_rounding(
    models: dict[str, ReflectanceModel], expected: dict[str, FloatArray], pairs: Pairs, tmp_path: Path
) -> None:
    text = _GLSL_AS_CPP
    for k, model in enumerate(models.values()):
        write(model, "glsl", tmp_path / "m.glsl")
        # C++ reads a literal without f as double; GLSL knows no double here.
        literal = r"(?<![\w.])(\d+\.\d+(?:e[-+]?\d+)?|\d+e[-+]?\d+)"
        snippet = re.sub(literal, r"\1f", (tmp_path / "m.glsl").read_text())
        text += f"namespace m{k} {{\n{snippet}\n}}\n" + _MANY.format(k=k)
    (tmp_path / "all.cpp").write_text(text)
    library = tmp_path / "all.so"
    subprocess.run(
        [_needed("g++"), "-O1", "-ffp-contract=off", "-shared", "-fPIC", "-o", library, tmp_path / "all.cpp"],
        check=True,
    )
    found = ctypes.CDLL(str(library))
    given = [w.astype(np.float32) for w in pairs]
    rng = np.random.default_rng(5)
    for k, (name, model) in enumerate(models.items()):
        value = np.zeros((len(pairs[0]), 3), np.float32)
        getattr(found, f"many{k}")(len(value), *map(_pointer, (*given, value)))
        # What rounding the directions themselves does to f: float32 can't be asked for more.
        felt = np.zeros_like(expected[name])
        for _ in range(4):
            nudged = [w * (1 + np.finfo(np.float32).eps * rng.choice([-1.0, 1.0], w.shape)) for w in pairs]
            felt = np.maximum(felt, np.abs(np.asarray(model.evaluate(*nudged)) - expected[name]))
        allowed = 1e-5 * np.abs(expected[name]) + 8 * felt + 1e-30
        worst = np.max(np.abs(value - expected[name]) / allowed)
        assert worst <= 1, f"{name}: {worst}"


def glslang() -> tuple[str, dict[str, str]]:
    """The validator, the system's or that of the wheel, which has to be told where its libraries are."""
    prefix = Path(sysconfig.get_path("purelib")) / "cmeel.prefix"
    wheel = prefix / "bin" / "glslangValidator"
    if wheel.exists():
        return str(wheel), {**os.environ, "LD_LIBRARY_PATH": str(prefix / "lib")}
    return _needed("glslangValidator"), dict(os.environ)


def test_glsl_and_the_shader_of_brdf_explorer_compile(
    models: dict[str, ReflectanceModel], tmp_path: Path
) -> None:
    validator, environment = glslang()
    shaders: list[Path] = []
    for k, model in enumerate(models.values()):
        write(model, "glsl", tmp_path / "m.glsl")
        main = "void main() { colour = vec4(brdf(vec3(0.0, 0.0, 1.0), vec3(0.6, 0.0, 0.8)), 1.0); }"
        _shader(tmp_path / f"a{k}.frag", (tmp_path / "m.glsl").read_text() + main, shaders)
        write(model, "disney", tmp_path / "m.brdf")
        whole = (tmp_path / "m.brdf").read_text()
        assert whole.startswith("analytic\n")
        sliders = re.findall(r"^float (p_\w+) (\S+) (\S+) (\S+)$", whole, re.MULTILINE)
        assert len({name for name, *_ in sliders}) == len(sliders) > 0
        for _, low, high, value in sliders:
            assert float(low) <= float(value) <= float(high)
        body = whole.partition("::begin shader\n")[2].partition("::end shader")[0]
        uniforms = "".join(f"uniform float {name};\n" for name, *_ in sliders)
        up, along, across = "vec3(0.0, 0.0, 1.0)", "vec3(1.0, 0.0, 0.0)", "vec3(0.0, 1.0, 0.0)"
        call = f"BRDF({up}, vec3(0.6, 0.0, 0.8), {up}, {along}, {across})"
        main = f"void main() {{ colour = vec4({call}, 1.0); }}"
        _shader(tmp_path / f"b{k}.frag", f"{uniforms}{body}{main}", shaders)
    done = subprocess.run([validator, *shaders], capture_output=True, text=True, env=environment)
    assert done.returncode == 0, done.stdout[-4000:]


def _shader(path: Path, body: str, into: list[Path]) -> None:
    path.write_text(f"#version 330 core\nout vec4 colour;\n{body}\n")
    into.append(path)


def test_models_without_a_source_are_refused(tmp_path: Path) -> None:
    with pytest.raises(SpecError, match="no source of ashikhmin_shirley"):
        write(create("ashikhmin_shirley"), "c", tmp_path / "m.c")
    with pytest.raises(SpecError, match="ideal mirror"):
        write(create("specular"), "c", tmp_path / "m.c")
    with pytest.raises(SpecError, match="transmits"):
        write(create("rough_dielectric"), "json", tmp_path / "m.json")
    assert not list(tmp_path.iterdir())


def test_a_model_of_many_channels_is_one_function_of_the_channel(tmp_path: Path) -> None:
    spectral = create("ward", channels=("450nm", "550nm", "650nm", "750nm"))
    told = write(spectral, "glsl", tmp_path / "m.glsl")
    assert "float brdf(int channel, vec3 wi, vec3 wo)" in (tmp_path / "m.glsl").read_text()
    assert [note.code for note in told.notes] == ["channels"]
    with pytest.raises(SpecError, match="one channel or three"):
        write(spectral, "disney", tmp_path / "m.brdf")


def test_names_end_no_comment(tmp_path: Path) -> None:
    nasty = "worn --> */ \\ é\n\\"
    model = create("ward", channels=(nasty, "b", "c", "d\\"), kd=[0.1, 0.2, 0.3, 0.4])
    for name in ("c", "python", "glsl"):
        write(model, name, tmp_path / name, name=nasty)
    source = (tmp_path / "c").rename(tmp_path / "m.c")
    subprocess.run([_needed("gcc"), "-std=c99", "-Wall", "-Werror", "-fsyntax-only", source], check=True)
    assert len(runpy.run_path(str(tmp_path / "python"))["brdf"]((0, 0, 1.0), (0, 0, 1.0))) == 4
    snippet = (tmp_path / "glsl").read_text()
    assert snippet.isascii()
    assert "\\" not in snippet
