"""C99: torques, currents, gravity, friction, inertia, regressor and momentum of a pose, without allocation."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from string import Template

import casadi as ca
import numpy as np

from gtau.documents.files import suffixes
from gtau.estimation.results.result import Result
from gtau.export.exported import Export, Exported, written
from gtau.model.loop_paths import CONTRACTION
from gtau.model.loops import CONDITION
from gtau.uses.identified import Functions, Identified, functions, identified, notes_on

TEMPLATES = Path(__file__).with_name("templates")
NEWTON_STEPS = 4  # from 0.01 rad away corrections are about 1e-2, 1e-4, 1e-8, 1e-16: the fourth is rounding
CLOSED = 1e-8  # of the last correction; the remaining error is its square
STARTING_STEPS = 200  # from home: a few milliradians or millimetres each
BANDWIDTH = 100.0  # of the controller of the example, rad/s
FINITE_MATH = """\
#if defined(_M_FP_FAST) || (defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__)
#error "isfinite() means nothing with -ffinite-math-only, -ffast-math or /fp:fast: compile without"
#endif"""
TAKEN = re.compile(  # example.c, kernel_torques() and the headers of the C library
    "example|kernel|assert|complex|ctype|errno|fenv|float|inttypes|iso646|limits|locale|math|setjmp|signal|"
    "stdarg|stdbool|stddef|stdint|stdio|stdlib|string|tgmath|time|wchar|wctype"
)
HELPER = re.compile(r"^casadi_real casadi_\w+\([^)]*\) *\{.*?\}$", re.MULTILINE | re.DOTALL)
BODY = re.compile(r"^static int casadi_f\d+\([^)]*\) *\{\n(.*?)^ *return 0;\n\}", re.MULTILINE | re.DOTALL)


def export(result: Result, out: Path) -> Exported:
    """Write C sources, header, controller, observer, example and CMake file of the identified model into ``out``."""
    model = identified(result)
    return Exported(written(out, c_files(model)), notes=notes_on(model))


def c_files(model: Identified) -> dict[str, str]:
    """Generate the C sources, header, example and CMake file: texts by file name."""
    if TAKEN.fullmatch(model.name):
        model = replace(model, name=f"robot_{model.name}")
    made, name = functions(model), model.name
    fields = _fields(model, made)
    return {
        f"{name}.h": _filled("model.h", fields),
        f"{name}.c": _filled("model.c", fields),
        f"{name}_controller.h": _filled("controller.h", fields),
        f"{name}_controller.c": _filled("controller.c", fields),
        f"{name}_observer.h": _filled("observer.h", fields),
        f"{name}_observer.c": _filled("observer.c", fields),
        "example.c": _filled("example.c", fields),
        "CMakeLists.txt": _filled("CMakeLists.txt", fields),
    }


def _filled(template: str, fields: Mapping[str, str]) -> str:
    return Template((TEMPLATES / f"{template}.in").read_text(encoding="utf-8")).substitute(fields)


def _fields(model: Identified, made: Functions) -> dict[str, str]:
    result, n = model.result, len(model.joints)
    loops = result.idm.loops
    home = made.home[made.actuated]
    turns = [result.robot.joint(joint).turns for joint in model.joints]
    limits = [result.robot.joint(joint).limits for joint in model.joints]
    velocities = [each.velocity or 10.0 for each in limits]
    efforts = [each.effort or 0.0 for each in limits]
    length = 1.0 if loops is None else loops.length
    fields = {
        "title": f"Inverse dynamics of the robot '{in_c(result.robot.name)}'",
        "robot": in_c(result.robot.name),
        "method": result.method,
        "runs": in_c(textwrap.shorten(", ".join(result.runs), 60, placeholder=" ...")),
        "name": model.name,
        "NAME": model.name.upper(),
        "n": f"{n:<3}",
        "n_p": f"{len(model.parameters):<3}",
        "n_c": f"{len(made.home):<3}",
        "states": str(len(made.presliding)),
        "presliding": _presliding(made),
        "joint_table": "\n".join(_joint_rows(model, turns)),
        "friction": textwrap.fill(
            in_c(result.friction_law.range_sentence), 116, initial_indent=" * ", subsequent_indent=" * "
        ),
        "usage": _usage(model.name),
        "newton_steps": str(NEWTON_STEPS),
        "starting_steps": str(STARTING_STEPS),
        "closed": repr(CLOSED),
        "contraction": repr(CONTRACTION),
        "condition": repr(CONDITION),
        "length": f"{length:.4g}",
        "actuated": ", ".join(map(str, made.actuated)),
        "home": _numbers(made.home),
        "gains": _numbers(model.gains),
        "home_q": _numbers(home),
        "amplitude": ", ".join("0.02" if turn else f"{0.02 * length:.4g}" for turn in turns),
        "limits": _numbers(np.array(efforts) / np.abs(model.gains)),
        "limited": "the robot file's efforts over the drive gains" + (", 0 where it has none" * (0.0 in efforts)),
        "velocities": _numbers(velocities),
        "following": _numbers(3.0 / BANDWIDTH * np.array(velocities)),
        "bandwidth": repr(BANDWIDTH),
        "finite_math": FINITE_MATH,
        "csv_head": ",".join(["t", *(f"{kind}{in_c(joint)}" for kind in "vu" for joint in model.joints)]),
        "payload_declarations": "".join(
            f"extern const double {model.name}_parameters_with_{end}[{model.name.upper()}_PARAMETERS];"
            f" /* {in_c(load)} */\n"
            for load, end in suffixes(model.payloads).items()
        ),
        "parameter_arrays": "\n".join(_parameter_arrays(model)),
        "kernels": _kernels(made),
    }
    return fields | {"closing": _filled("serial.c" if made.step is None else "loops.c", fields)}


def _presliding(made: Functions) -> str:
    """Write the update of the presliding friction states with the configuration."""
    first, lines = len(made.home) - len(made.presliding), []
    for k, (width, ratios) in enumerate(made.presliding, start=first):
        way = " + ".join(f"{ratio!r} * (after[{place}] - before[{place}])" for place, ratio in ratios.items())
        moved = f"fmin(fmax(before[{k}] + ({way}) / {width!r}, -1.0), 1.0)"
        lines.append(f"  after[{k}] = before[{k}] > 1.0 ? before[{k}] : {moved};")
    return "\n".join(lines or ["  (void)before;", "  (void)after;"])


def _numbers(values: Iterable[float]) -> str:
    return ", ".join(repr(float(value)) for value in values)


def _joint_rows(model: Identified, turns: list[bool]) -> Iterator[str]:
    unit = "A" if model.result.kind == "current" else "unit of the logs"
    for k, (joint, turning) in enumerate(zip(model.joints, turns, strict=True)):
        yield (
            f" *   {k}  {in_c(joint):<12} q in {'rad' if turning else 'm'}, torque in {model.units[k]}, "
            f"drive gain {model.gains[k]:.6g} {model.units[k]}/{unit}"
        )


def _usage(name: str) -> str:
    calls = (
        f"{name}_pose pose;",
        f"{name}_start(&pose, q);",
        f"if ({name}_move(&pose, q) == {name.upper()}_OK)",
        f"  {name}_currents(&pose, qd, qdd, {name}_parameters, current);",
    )
    return "\n".join(f" *   {call}" for call in calls)


def _parameter_arrays(model: Identified) -> Iterator[str]:
    size = f"[{model.name.upper()}_PARAMETERS]"
    yield f"const double {model.name}_parameters{size} = {{"
    for k, (each, value) in enumerate(zip(model.parameters, model.values, strict=True)):
        std = "" if each.std is None else f", standard deviation {each.std:.2g}"
        regrouping = "" if each.regrouping in ("", each.name) else f" = {each.regrouping}"
        comment = textwrap.shorten(f"{k} {each.name}, {each.unit}{std}{regrouping}", 90, placeholder=" ...")
        comment = comment.replace("*/", "* /").replace("/*", "/ *")
        yield f"    {float(value)!r}, /* {comment} */"
    yield "};"
    for end, values in zip(suffixes(model.payloads).values(), model.payloads.values(), strict=True):
        yield f"const double {model.name}_parameters_with_{end}{size} = {{"
        yield textwrap.fill(_numbers(values), 116, initial_indent="    ", subsequent_indent="    ")
        yield "};"


def _kernels(made: Functions) -> str:
    """Generate all functions as C: CasADi's code of each, with its arguments called by their names."""
    helpers: dict[str, None] = {}
    bodies = []
    for function in filter(None, (made.step, made.last_step)):
        outputs = ("moved", "size", "condition")[: function.n_out()]
        bodies.append(_kernel(function, ("c",), outputs, helpers))
    for function in made.outputs.values():
        bodies.append(_kernel(function, ("c", "qd", "qdd", "p"), ("out",), helpers))
    return "\n\n".join([*helpers, *bodies, ""])


def _kernel(function: ca.Function, inputs: tuple[str, ...], outputs: tuple[str, ...], helpers: dict[str, None]) -> str:
    generator = ca.CodeGenerator("kernel.c", {"with_header": False, "include_math": False})
    generator.add(function)
    text = generator.dump()
    helpers |= {f"static {found.group()}".replace("casadi_real", "double"): None for found in HELPER.finditer(text)}
    found = BODY.search(text)
    assert found is not None, "CasADi writes its functions in another form than this version reads"
    body = found.group(1).replace("casadi_real", "double")
    body = re.sub(r"arg\[(\d+)\]\? *arg\[\1\]\[(\d+)\] *: *0", lambda m: f"{inputs[int(m[1])]}[{m[2]}]", body)
    body = re.sub(r"if \(res\[(\d+)\]!=0\) *res\[\1\]\[(\d+)\]", lambda m: f"{outputs[int(m[1])]}[{m[2]}]", body)
    assert not re.search(r"\b(arg|res)\[", body), "CasADi writes arguments in another form than this version reads"
    unused = [name for name in inputs if not re.search(rf"\b{name}\[", body)]
    arguments = [*(f"const double *{name}" for name in inputs), *(f"double *{name}" for name in outputs)]
    ignored = "".join(f"  (void)({name});\n" for name in unused)
    return f"static void kernel_{function.name()}({', '.join(arguments)}) {{\n{ignored}{body}}}"


def in_c(text: str) -> str:
    """Clean a text so that it is safe in a comment and in a string of C."""
    return re.sub(r"[^\w .,:;()+/-]", "_", text, flags=re.ASCII)


EXPORTS = {"c": Export(export)}
